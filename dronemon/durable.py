"""Files that are whole whenever the program or the machine stops."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Iterable
from errno import ETIMEDOUT
from io import FileIO
from pathlib import Path
from queue import SimpleQueue

SILENT_DISK_S = 10.0
"""Wall time for a line to get to the disk."""


class LineWriter:
    """Adds lines to files, each synced, in a thread of its own: a disk may take its time.

    A last line that a crash has cut short is taken away first.
    num_lines: handed over; num_lost: could not be written whole, and were taken back.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self.num_lines = self.num_lost = 0
        self._files = {path: _open_whole(path) for path in paths}
        self._queue = SimpleQueue[tuple[Path, bytes] | threading.Event | None]()
        self._failure: OSError | None = None
        self._busy_since: float | None = None
        self._thread = threading.Thread(target=self._work, name="lines", daemon=True)
        self._thread.start()

    def add(self, path: Path, line: bytes) -> None:
        """Hand over a line for one of the files."""
        self.num_lines += 1
        self._queue.put((path, line))

    def check(self) -> None:
        """Raises OSError, with its file's name: a line was lost, or is not written for too long."""
        since, failure, self._failure = self._busy_since, self._failure, None
        if failure is not None:
            raise failure
        if since is not None and time.monotonic() > since + SILENT_DISK_S:
            raise OSError(ETIMEDOUT, f"its disk takes nothing for {SILENT_DISK_S:g} s")

    def flush(self) -> None:
        """Wait until all handed over so far is written. Raises OSError as `check` does."""
        written = threading.Event()
        self._queue.put(written)
        written.wait(SILENT_DISK_S)
        self.check()

    def close(self) -> None:
        """Write what was handed over, if the disk takes it, and close the files."""
        self._queue.put(None)
        self._thread.join(SILENT_DISK_S)

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            if isinstance(item, threading.Event):
                item.set()
                continue
            path, line = item
            self._busy_since = time.monotonic()
            try:
                _append(self._files[path], line)
            except OSError as exc:
                self.num_lost += 1
                exc.filename = path
                self._failure = exc
            self._busy_since = None
        for file in self._files.values():
            file.close()


def _open_whole(path: Path) -> FileIO:
    """Open a file of lines, new or not, to add whole ones."""
    file = path.open("ab", buffering=0)
    whole = path.read_bytes().rpartition(b"\n")
    file.truncate(len(whole[0]) + len(whole[1]))
    return file


def _append(file: FileIO, line: bytes) -> None:
    """Add one whole, synced line, or nothing and raise OSError."""
    end = file.tell()
    try:
        write_all(file, line)
        os.fsync(file)
    except OSError:
        with contextlib.suppress(OSError):
            file.truncate(end)
            file.seek(end)
        raise


def replace_text(path: Path, text: str) -> None:
    """Write a file as a whole, on disk before this returns. Raises OSError: it is as it was."""
    part = path.with_name(f".{path.name}.part")
    with contextlib.suppress(FileNotFoundError):
        part.unlink()
    write_new(part, text)
    part.replace(path)
    sync_folder(path.parent)


def write_new(path: Path, text: str) -> None:
    """Write a file that must not be there yet. Raises OSError."""
    with path.open("xb", buffering=0) as file:
        write_all(file, text.encode())
        os.fsync(file)


def write_all(file: FileIO, data: bytes) -> None:
    """Write all, in as many pieces as it takes. Raises OSError."""
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]


def sync_folder(path: Path) -> None:
    """Have names that were made, replaced or removed on disk. Raises OSError."""
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
