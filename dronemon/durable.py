"""Files that are whole whenever the program or the machine stops."""

from __future__ import annotations

import contextlib
import os
from io import FileIO
from pathlib import Path


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
