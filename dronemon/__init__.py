"""dronemon: one drone keeps watch over several moving targets."""

import contextlib
import hashlib
import os
import tempfile
from pathlib import Path

__version__ = "0.1.0"


def compiled_folder(package: Path) -> Path:
    """Where numba keeps what it compiled of this state of the sources.

    Numba looks at the file of each function, but not at constants and functions of other files.
    """
    state = hashlib.sha256()
    for pattern in ("problem.py", "arena/*.py", "belief/*.py", "planner/*.py"):
        for file in sorted(package.glob(pattern)):
            state.update(file.read_bytes())
    name = f"compiled-{state.hexdigest()[:16]}"
    roots = [package / "__pycache__"]
    with contextlib.suppress(RuntimeError):  # a user without a home
        roots.append(Path.home() / ".cache" / "dronemon")
    for root in roots:
        with contextlib.suppress(OSError):  # an installation may be read-only
            (root / name).mkdir(parents=True, exist_ok=True)
            if os.access(root / name, os.W_OK):
                return root / name
    return Path(tempfile.mkdtemp())


os.environ.setdefault("NUMBA_CACHE_DIR", str(compiled_folder(Path(__file__).parent)))
