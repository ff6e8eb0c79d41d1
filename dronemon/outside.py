"""Classes of others, named package.module:Class: planners and detectors."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dronemon.errors import OptionError

CLASS_PATTERN = r"^([A-Za-z_][\w.]*):([A-Za-z_]\w*)$"


def find_class(path: str, role: str) -> Callable[..., Any]:
    """What package.module:Class names, also in the folder that we run in.

    role: what it is to be, for the error. Raises OptionError.
    """
    match = re.match(CLASS_PATTERN, path)
    if match is None:
        raise OptionError(f"{role} {path!r} is not of the form package.module:Class")
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))
    try:
        module = importlib.import_module(match[1])
    except (Exception, SystemExit) as exc:  # a module of others may fail in any way
        raise OptionError(
            f"{role} {path!r}: module {match[1]} cannot be imported: {exc!r}; run where it lies, "
            "or install it"
        ) from exc
    found: Callable[..., Any] | None = getattr(module, match[2], None)
    if not callable(found):
        own = [v for v in vars(module).values() if getattr(v, "__module__", "") == match[1]]
        classes = [v.__name__ for v in own if isinstance(v, type)]
        raise OptionError(
            f"{role} {path!r}: module {match[1]} has no class {match[2]}; "
            f"its classes are: {', '.join(classes) or 'none'}"
        )
    return found
