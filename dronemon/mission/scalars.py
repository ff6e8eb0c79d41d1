"""Numbers and texts that mean what they look like: what YAML 1.1 reads otherwise is refused."""

from __future__ import annotations

import math
import re
import unicodedata

import yaml


class Loader(yaml.SafeLoader):
    """Reads YAML 1.1, but `2e2` is a number, as in YAML 1.2."""


class Dumper(yaml.SafeDumper):
    """Writes what `Loader` reads."""


_FLOAT = "tag:yaml.org,2002:float"
_NUMBERS = {"tag:yaml.org,2002:int", _FLOAT}
_DECIMAL = re.compile(r"[-+]?(0|[1-9]\d*|\d+\.\d*|\.\d+|(\d+\.?\d*|\.\d+)[eE][-+]?\d+)", re.A)
_EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")
for _kind in (Loader, Dumper):
    _kind.add_implicit_resolver(_FLOAT, _EXPONENT, list("-+.0123456789"))
_UNSEEN = {"Cc", "Cs", "Zl", "Zp"}
"""Unicode's control characters, surrogates, and separators of lines and paragraphs."""


def number(text: str) -> float:
    """The number that a text is in a mission file. Raises ValueError for what is refused there."""
    if not _DECIMAL.fullmatch(text):
        raise ValueError(f"{text!a} is no decimal number")
    return float(text)


def scalar_flaw(node: yaml.Node) -> str | None:
    """Say why a scalar cannot be taken, if so. Raises ValueError or YAMLError if it is broken."""
    if not isinstance(node, yaml.ScalarNode):
        return None
    text: str = node.value
    if unseen := next((c for c in text if unicodedata.category(c) in _UNSEEN), None):
        return f"has the character {unseen!a} in it, which cannot be shown; leave it out"
    if node.tag not in _NUMBERS or _DECIMAL.fullmatch(text):
        return None
    value = yaml.load(text, Loader)
    if not isinstance(value, int | float) or not math.isfinite(value):
        return None
    digits = text.replace("_", "").lstrip("0")
    ways = dict.fromkeys([digits, str(value)] if digits.isdigit() else [str(value)])
    return f"`{text}` would be read as {value}; write {' or '.join(ways)}, or a text in quotes"
