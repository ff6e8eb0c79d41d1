"""From finished episodes to tables: means with standard errors, beside the paper's figures.

unc, unc_std, min_ob, jsd   as in the paper's Table I; `_se` is the standard error of the mean
                            over instances
gap closed                  (P - ours) / (P - C), with P the paper's network and C the
                            clairvoyant search, of the means over the paper's 16 cells
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from importlib.resources import files
from itertools import combinations

import numpy as np

from dronemon.evaluation.options import TABLE1_SPEED_RATIOS, TABLE1_TARGETS, Cell
from dronemon.evaluation.results import Result

PAPER_FIGURES = ("unc", "unc_std", "min_ob", "jsd")
FIGURES = (*PAPER_FIGURES, "lost", "since_seen_au", "peak_error_au")
RANKED = {"unc": -1, "min_ob": 1, "jsd": -1}
"""Figures that Table I marks the best of: 1 where more is better, -1 where less is."""
PAPER_NETWORK = "STAMP"
BOUND = "clairvoyant-search"
COUNTERPARTS = {"tsp": "TSP Loop", "stamp": PAPER_NETWORK}
"""Published methods that ours of these names were built after."""
AGREEMENT = {"unc": 0.02, "jsd": 0.03}
"""Differences from the published figure that count as agreement."""
TABLE1_CELLS = tuple(
    Cell(prior="full", num_targets=count, speed_ratio=speed)
    for count in TABLE1_TARGETS
    for speed in TABLE1_SPEED_RATIOS
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A mean over instances and its standard error, NaN for fewer than two."""

    mean: float
    standard_error: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Estimate:
        """Estimate from independent values; NaN ones are left out."""
        finite = np.array([value for value in values if not math.isnan(value)], dtype=np.float64)
        return cls(
            mean=float(finite.mean()) if finite.size else math.nan,
            standard_error=(
                float(finite.std(ddof=1) / math.sqrt(finite.size)) if finite.size > 1 else math.nan
            ),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One method in one cell; `instances` is 0 for published figures."""

    cell: Cell
    method: str
    instances: int
    figures: Mapping[str, Estimate]
    decision_s: float


def summarise(results: Iterable[Result]) -> list[Row]:
    """Average episodes over instances. -> one row per method and cell, in order of appearance."""
    groups: dict[tuple[Cell, str], list[Result]] = {}
    for result in results:
        groups.setdefault((result.cell, result.method), []).append(result)
    return [
        Row(
            cell=cell,
            method=method,
            instances=len(group),
            figures={
                name: Estimate.of(float(getattr(result.scores, name)) for result in group)
                for name in FIGURES
            },
            decision_s=float(np.mean([result.decision_s for result in group])),
        )
        for (cell, method), group in groups.items()
    ]


def published_rows() -> list[Row]:
    """The paper's Table I."""
    text = files("dronemon.evaluation").joinpath("published.csv").read_text(encoding="utf-8")
    return [
        Row(
            cell=Cell(
                prior="full",
                num_targets=int(record["targets"]),
                speed_ratio=Fraction(record["speed_ratio"]),
            ),
            method=record["method"],
            instances=0,
            figures={
                name: Estimate(mean=float(record[name]), standard_error=math.nan)
                for name in PAPER_FIGURES
            },
            decision_s=math.nan,
        )
        for record in csv.DictReader(io.StringIO(text))
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """How much lower one method's figure is than another's on the same instances.

    Means over cells of the mean over instances; negative: `method` is lower than `other`.
    """

    method: str
    other: str
    cells: int
    figures: Mapping[str, Estimate]


def paired_differences(results: Sequence[Result]) -> list[Difference]:
    """Compare every two methods on the cells and instances that both flew."""
    methods = list(dict.fromkeys(result.method for result in results))
    by_method: dict[str, dict[tuple[Cell, int], Result]] = {method: {} for method in methods}
    for result in results:
        by_method[result.method][result.cell, result.seed] = result
    return [_difference(a, b, by_method[a], by_method[b]) for a, b in combinations(methods, 2)]


def _difference(
    method: str,
    other: str,
    ours: Mapping[tuple[Cell, int], Result],
    theirs: Mapping[tuple[Cell, int], Result],
) -> Difference:
    """Average over instances in each cell, then over cells."""
    shared = [key for key in ours if key in theirs]
    cells = list(dict.fromkeys(cell for cell, _ in shared))
    figures = {}
    for name in RANKED:
        per_cell = [
            Estimate.of(
                float(getattr(ours[key].scores, name) - getattr(theirs[key].scores, name))
                for key in shared
                if key[0] == cell
            )
            for cell in cells
        ]
        figures[name] = _mean_over_cells(per_cell)
    return Difference(method=method, other=other, cells=len(cells), figures=figures)


def _mean_over_cells(estimates: Sequence[Estimate]) -> Estimate:
    """Mean of independent estimates, each cell counting the same."""
    errors = np.array([estimate.standard_error for estimate in estimates])
    return Estimate(
        mean=float(np.mean([estimate.mean for estimate in estimates])) if estimates else math.nan,
        standard_error=float(np.sqrt((errors**2).sum()) / len(estimates))
        if estimates
        else math.nan,
    )


def overall(rows: Iterable[Row], method: str) -> dict[str, Estimate] | None:
    """A method's means over the paper's 16 cells; None if one of them is missing."""
    by_cell = {row.cell: row for row in rows if row.method == method}
    if not all(cell in by_cell for cell in TABLE1_CELLS):
        return None
    return {
        name: _mean_over_cells([by_cell[cell].figures[name] for cell in TABLE1_CELLS])
        for name in PAPER_FIGURES
    }


def gap_closed(ours: float, network: float, bound: float) -> float:
    """Share of the way from the paper's network to the bound."""
    return (network - ours) / (network - bound)


def count_better(rows: Sequence[Row], method: str) -> tuple[int, int]:
    """Figures of Table I that beat the best published of any method. -> better, compared."""
    published: dict[Cell, list[Row]] = {}
    for row in published_rows():
        published.setdefault(row.cell, []).append(row)
    better = compared = 0
    for row in rows:
        if row.method != method or row.cell not in published:
            continue
        for name, sign in RANKED.items():
            best = max(sign * other.figures[name].mean for other in published[row.cell])
            better += sign * row.figures[name].mean > best
            compared += 1
    return better, compared


def count_agreeing(rows: Sequence[Row], method: str) -> tuple[int, int]:
    """Cells where a method agrees with the published one it was built after. -> agreeing, compared.

    Agreeing: every figure of `AGREEMENT` differs by at most its limit.
    """
    counterpart = COUNTERPARTS[method]
    published = {row.cell: row for row in published_rows() if row.method == counterpart}
    mine = [row for row in rows if row.method == method and row.cell in published]
    agreeing = sum(
        all(
            abs(row.figures[name].mean - published[row.cell].figures[name].mean) <= limit + 1e-9
            for name, limit in AGREEMENT.items()
        )
        for row in mine
    )
    return agreeing, len(mine)
