"""The recording's file, written by us rather than by Rerun: its own writer can hang on a full disk.

Rerun writes into a pipe; a thread empties it into the file and the live page. When the file cannot
be written any more the thread goes on, so that the page continues and the recording can end.
"""

from __future__ import annotations

import contextlib
import os
import threading
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from dronemon.errors import ViewError
from dronemon.viz.page import LivePage

CHUNK_BYTES = 1 << 16


class RecordingFile:
    """A new file at `path` that a Rerun sink writes into; `error` says why it ends early, if so."""

    def __init__(self, path: Path, page: LivePage | None) -> None:
        self.error: str | None = None
        try:
            self._file = path.open("xb", buffering=0)
        except OSError as exc:
            raise ViewError(f"cannot make the recording {path}: {exc.strerror}") from exc
        self._path = path
        self._page = page
        self._read_fd, self._write_fd = os.pipe()
        self._thread = threading.Thread(target=self._copy, name="viz-file", daemon=True)
        self._thread.start()

    def take(self, recording: rr.RecordingStream, layout: rrb.Blueprint) -> None:
        """Have Rerun alone write into the pipe, so that the file ends when the recording does."""
        sink = rr.FileSink(f"/dev/fd/{self._write_fd}")
        recording.set_sinks(sink, default_blueprint=layout)
        os.close(self._write_fd)

    def wait(self, timeout_s: float) -> None:
        """Wait for the end of the recording to be in the file."""
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            self.error = self.error or f"{self._path} was not finished within {timeout_s} s"

    def _copy(self) -> None:
        with os.fdopen(self._read_fd, "rb", buffering=0) as pipe, self._file:
            while data := pipe.read(CHUNK_BYTES):
                if self._page is not None:
                    self._page.feed(data)
                if self.error is None:
                    self._write(data)
            with contextlib.suppress(OSError):
                os.fsync(self._file.fileno())

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as exc:
            self.error = f"cannot write {self._path}: {exc.strerror}"
