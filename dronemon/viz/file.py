"""The recording's file, written by us rather than by Rerun: its own writer can hang on a full disk.

Rerun writes into a pipe; a thread empties it into the file. When the file cannot be written any
more the thread goes on emptying the pipe, so that the live view continues and the recording ends.
"""

from __future__ import annotations

import contextlib
import os
import threading
from pathlib import Path

import rerun as rr

from dronemon.errors import ViewError

CHUNK_BYTES = 1 << 16


class RecordingFile:
    """A new file at `path` that a Rerun sink writes into; `error` says why it ends early, if so."""

    def __init__(self, path: Path) -> None:
        self.error: str | None = None
        try:
            self._file = path.open("xb", buffering=0)
        except OSError as exc:
            raise ViewError(f"cannot make the recording {path}: {exc.strerror}") from exc
        self._path = path
        self._read_fd, self._write_fd = os.pipe()
        self._thread = threading.Thread(target=self._copy, name="viz-file", daemon=True)
        self._thread.start()

    def sink(self) -> rr.FileSink:
        """Give Rerun the pipe. Call `handed_over` once the sink is in use."""
        return rr.FileSink(f"/dev/fd/{self._write_fd}")

    def handed_over(self) -> None:
        """Leave Rerun the only writer, so that the file ends when the recording does."""
        os.close(self._write_fd)

    def wait(self, timeout_s: float) -> None:
        """Wait for the end of the recording to be in the file."""
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            self.error = self.error or f"{self._path} was not finished within {timeout_s} s"

    def _copy(self) -> None:
        with os.fdopen(self._read_fd, "rb", buffering=0) as pipe:
            try:
                with self._file:
                    while data := pipe.read(CHUNK_BYTES):
                        self._write(data)
                    os.fsync(self._file.fileno())
            except OSError as exc:
                self.error = f"cannot write {self._path}: {exc.strerror}"
            with contextlib.suppress(OSError):
                while pipe.read(CHUNK_BYTES):
                    pass

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]
