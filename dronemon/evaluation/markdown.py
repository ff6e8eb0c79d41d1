"""Numbers and tables as Markdown shows them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from dronemon.evaluation.tables import Estimate

DIGITS = {"min_ob": 2}
"""Digits after the point of a figure; 3 for others."""


def number(value: float, name: str, *, extra_digits: int = 0) -> str:
    """A figure with its usual digits; empty where there is none."""
    if math.isnan(value):
        return ""
    return f"{value:.{DIGITS.get(name, 3) + extra_digits}f}"


def plus_minus(estimate: Estimate, name: str) -> str:
    """A mean with its standard error, if it has one."""
    error = number(estimate.standard_error, name)
    return number(estimate.mean, name) + (f" ± {error}" if error else "")


def markdown_table(header: Sequence[str], body: Iterable[Sequence[str]]) -> list[str]:
    """A table in Markdown, followed by an empty line."""
    lines = [header, ["---"] * len(header), *body]
    return [*("| " + " | ".join(cells) + " |" for cells in lines), ""]
