"""Which code runs: the version, and in a checkout the commit, for the records that a run leaves."""

from __future__ import annotations

import hashlib
import subprocess
from functools import cache
from pathlib import Path

from dronemon import __version__

GIT_TIMEOUT_S = 10.0


@cache
def code_version() -> str:
    """Version of the code that runs, as it was when this was first asked.

    -> 0.1.0+14d6d97ca1 in a checkout, with the last commit that changed the package;
       0.1.0+14d6d97ca1.changed.3fa1b2c4 with a digest of the files where they are not as committed;
       0.1.0 without a commit
    """
    folder = Path(__file__).parent
    commit = find_commit(folder)
    return __version__ if commit is None else f"{__version__}+{commit}"


@cache
def code_digest() -> str:
    """Digest of the package's code, the same wherever it lies. -> 8 hexadecimal digits."""
    return _digest(Path(__file__).parent)


def find_commit(folder: Path) -> str | None:
    """Last commit that changed a folder; None if git is not there or does not track the folder."""
    try:
        commit = _git(folder, "log", "-1", "--format=%h", "--abbrev=10", "--", ".")
        is_changed = _git(folder, "status", "--porcelain", "--", ".") != ""
    except (OSError, subprocess.SubprocessError):
        return None
    if not commit:
        return None
    return f"{commit}.changed.{_digest(folder)}" if is_changed else commit


def _git(folder: Path, *arguments: str) -> str:
    """Ask git, without touching the index that others may be writing."""
    result = subprocess.run(
        ["git", "--no-optional-locks", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=GIT_TIMEOUT_S,
        check=True,
    )
    return result.stdout.strip()


def _digest(folder: Path) -> str:
    """Short digest of the names and bytes of all Python files. -> 8 hexadecimal digits."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(f"{path.relative_to(folder)}\n".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:8]
