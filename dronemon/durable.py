"""Files that are whole whenever the program or the machine stops."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterable
from errno import ETIMEDOUT
from io import FileIO
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryFile

from dronemon.errors import RecordError

SILENT_DISK_S = 10.0
"""Wall time for a line to get to the disk."""
_Item = tuple[Path, bytes] | threading.Event | None
"""A line for a file; what is set once all before it is on disk; the end."""


def claim(folder: Path) -> None:
    """Make sure that files can be written to a folder. Raises RecordError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError as exc:
        raise RecordError(f"{folder}: {exc.strerror}; choose another --out") from exc


class LineWriter:
    """Adds lines to files: one thread writes them, another syncs them, as a disk may take its time.

    What is written outlives this program, also while the disk is busy with what was before; what is
    synced outlives the machine. A last line that a crash has cut short is taken away first.
    num_lines: handed over
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self.num_lines = 0
        self._files = {path: _open_whole(path) for path in paths}
        self._syncing = _Stage("lines to disk", self._sync, self._done)
        self._writing = _Stage("lines", self._write, self._syncing.put)

    @property
    def num_lost(self) -> int:
        """Lines that could not be written whole, and were taken back, or could not be synced."""
        return self._writing.num_failed + self._syncing.num_failed

    def add(self, path: Path, line: bytes) -> None:
        """Hand over a line for one of the files."""
        self.num_lines += 1
        self._writing.put((path, line))

    def check(self) -> None:
        """Raises OSError, with its file's name: a line was lost, or is not on disk for too long."""
        self._writing.check()
        self._syncing.check()

    def flush(self) -> None:
        """Wait until all handed over so far is on disk. Raises OSError as `check` does."""
        synced = threading.Event()
        self._writing.put(synced)
        synced.wait(SILENT_DISK_S)
        self.check()

    def close(self) -> None:
        """Write what was handed over, if the disk takes it, and close the files."""
        self._writing.put(None)
        self._syncing.thread.join(SILENT_DISK_S)

    def _write(self, path: Path, line: bytes) -> None:
        _append(self._files[path], line)

    def _sync(self, path: Path, _: bytes) -> None:
        os.fsync(self._files[path])

    def _done(self, item: _Item) -> None:
        if isinstance(item, threading.Event):
            item.set()
        elif item is None:
            for file in self._files.values():
                file.close()


class _Stage:
    """Takes one step with each line, in order, in a thread of its own, and hands it on.

    An event is handed on alone; None, too, and ends it.
    """

    def __init__(
        self, name: str, step: Callable[[Path, bytes], None], hand_on: Callable[[_Item], None]
    ) -> None:
        self.num_failed = 0
        self._step, self._hand_on = step, hand_on
        self._queue = SimpleQueue[_Item]()
        self.put = self._queue.put
        self._failure: OSError | None = None
        self._busy_since: float | None = None
        self.thread = threading.Thread(target=self._work, name=name, daemon=True)
        self.thread.start()

    def check(self) -> None:
        """Raises OSError: a line failed, or takes too long."""
        since, failure, self._failure = self._busy_since, self._failure, None
        if failure is not None:
            raise failure
        if since is not None and time.monotonic() > since + SILENT_DISK_S:
            raise OSError(ETIMEDOUT, f"its disk takes nothing for {SILENT_DISK_S:g} s")

    def _work(self) -> None:
        item: _Item = threading.Event()
        while item is not None:
            item = self._queue.get()
            if not isinstance(item, tuple) or self._succeeds(*item):
                self._hand_on(item)

    def _succeeds(self, path: Path, line: bytes) -> bool:
        self._busy_since = time.monotonic()
        try:
            self._step(path, line)
        except OSError as exc:
            self.num_failed += 1
            exc.filename = path
            self._failure = exc
            return False
        finally:
            self._busy_since = None
        return True


def _open_whole(path: Path) -> FileIO:
    """Open a file of lines, new or not, to add whole ones."""
    file = path.open("ab", buffering=0)
    whole = path.read_bytes().rpartition(b"\n")
    file.truncate(len(whole[0]) + len(whole[1]))
    return file


def _append(file: FileIO, line: bytes) -> None:
    """Add one whole line, or nothing and raise OSError."""
    end = file.tell()
    try:
        write_all(file, line)
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
    try:
        write_new(part, text)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
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
