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

from dronemon.belief import Scores
from dronemon.evaluation.options import TABLE1, Cell
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
TABLE1_CELLS = tuple(TABLE1.cells)


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


def grouped(results: Iterable[Result]) -> dict[tuple[Cell, str], list[Result]]:
    """Episodes by cell and method, both in order of appearance."""
    groups: dict[tuple[Cell, str], list[Result]] = {}
    for result in results:
        groups.setdefault((result.cell, result.method), []).append(result)
    return groups


def average_by_cell(results: Iterable[Result]) -> list[Row]:
    """Average episodes over instances. -> one row per method and cell, in order of appearance."""
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
        for (cell, method), group in grouped(results).items()
    ]


def published_rows() -> list[Row]:
    """The paper's Table I."""
    text = files("dronemon.evaluation").joinpath("table1.csv").read_text(encoding="utf-8")
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
    scores: dict[str, dict[tuple[Cell, int], Scores]] = {}
    for result in results:
        scores.setdefault(result.method, {})[result.cell, result.seed] = result.scores
    differences = []
    for (method, ours), (other, theirs) in combinations(scores.items(), 2):
        shared = [(key, ours[key], theirs[key]) for key in ours if key in theirs]
        figures = {
            name: _mean_over_cells(
                {key: getattr(a, name) - getattr(b, name) for key, a, b in shared}
            )
            for name in RANKED
        }
        cells = len({cell for (cell, _), _, _ in shared})
        differences.append(Difference(method=method, other=other, cells=cells, figures=figures))
    return differences


def _mean_over_cells(values: Mapping[tuple[Cell, int], float]) -> Estimate:
    """Mean over instances, then over cells. values: by cell and seed.

    A seed is much the same world in every cell, so the error is that of the seeds' own means, of
    those seeds that flew all cells.
    """
    by_cell: dict[Cell, list[float]] = {}
    by_seed: dict[int, list[float]] = {}
    for (cell, seed), value in values.items():
        by_cell.setdefault(cell, []).append(value)
        by_seed.setdefault(seed, []).append(value)
    whole = [float(np.mean(few)) for few in by_seed.values() if len(few) == len(by_cell)]
    return Estimate(
        mean=float(np.mean([np.mean(few) for few in by_cell.values()])) if by_cell else math.nan,
        standard_error=Estimate.of(whole).standard_error,
    )


def overall(results: Iterable[Result], method: str) -> dict[str, Estimate] | None:
    """A method's means over the paper's 16 cells; None if one of them is missing."""
    flown = [r for r in results if r.method == method and r.cell in TABLE1_CELLS]
    if len({result.cell for result in flown}) < len(TABLE1_CELLS):
        return None
    return {
        name: _mean_over_cells({(r.cell, r.seed): float(getattr(r.scores, name)) for r in flown})
        for name in PAPER_FIGURES
    }


def published_overall() -> dict[str, dict[str, float]]:
    """Means over the 16 cells of the paper's methods, by method and figure."""
    rows = published_rows()
    return {
        method: {
            name: float(np.mean([row.figures[name].mean for row in rows if row.method == method]))
            for name in PAPER_FIGURES
        }
        for method in dict.fromkeys(row.method for row in rows)
    }


def gap_closed(ours: float, worse: float, bound: float) -> float:
    """Share of the way from a worse figure, such as the paper's network's, to the bound."""
    return (worse - ours) / (worse - bound)


def count_better(rows: Sequence[Row], method: str) -> tuple[int, int, int]:
    """Figures of Table I that beat the best published of any method.

    -> better, compared, and how many of the better ones are so by at most a standard error
    """
    published: dict[Cell, list[Row]] = {}
    for row in published_rows():
        published.setdefault(row.cell, []).append(row)
    better = compared = close = 0
    for row in rows:
        if row.method != method or row.cell not in published:
            continue
        for name, sign in RANKED.items():
            best = max(sign * other.figures[name].mean for other in published[row.cell])
            lead = sign * row.figures[name].mean - best
            better += lead > 0.0
            close += 0.0 < lead <= row.figures[name].standard_error
            compared += 1
    return better, compared, close


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
