"""What a run leaves behind as JSON: plain values, whatever an event or a planner holds."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

import numpy as np


def json_value(value: object) -> object:
    """Give a JSON value: lists for arrays, null for NaN, its text for what JSON does not know."""
    if isinstance(value, np.ndarray | np.generic):
        return json_value(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [json_value(item) for item in value]
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


def json_line(record: Mapping[str, object]) -> bytes:
    """A record on one line."""
    plain = json_value(record)
    text = json.dumps(plain, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.encode(errors="backslashreplace") + b"\n"  # a lone surrogate as JSON escapes it


def json_text(record: Mapping[str, object]) -> str:
    """A record for people to read, a value on each line."""
    return json.dumps(json_value(record), indent=2, ensure_ascii=False) + "\n"
