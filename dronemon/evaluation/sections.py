"""What the paper's Table II and Figure 5 ask, as sections of table.md.

Source: paper, section V-B and V-C.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from dronemon.evaluation.markdown import markdown_table, number, plus_minus
from dronemon.evaluation.options import TABLE2, TABLE2_PLANNERS, Cell, PlannerSpec
from dronemon.evaluation.results import Result
from dronemon.evaluation.tables import BOUND, Estimate, Row, gap_closed

TABLE2_ROWS = {PlannerSpec.parse(text).method: row for text, row in TABLE2_PLANNERS.items()}
"""Method -> its row in the paper's Table II."""

WORLD = ("motion", "sensor", "prior", "N", "r_v", "V")
LEAST_WAY = 0.01
"""Difference of the ends, in Unc or JSD, from which shares of it are told."""
WORST = "lawnmower"
"""What sees nothing of the targets: the other end of the way to the bound."""


def published_table2() -> dict[str, dict[int, float]]:
    """The paper's Table II: row -> nodes -> JSD."""
    text = files("dronemon.evaluation").joinpath("table2.csv").read_text(encoding="utf-8")
    table: dict[str, dict[int, float]] = {}
    for record in csv.DictReader(io.StringIO(text)):
        table.setdefault(record["history"], {})[int(record["nodes"])] = float(record["jsd"])
    return table


def table2_rows(rows: Iterable[Row]) -> dict[str, dict[Cell, Row]]:
    """Methods that flew every cell of Table II. -> method -> cell -> row"""
    by_method: dict[str, dict[Cell, Row]] = {}
    for row in rows:
        if row.cell in TABLE2.cells:
            by_method.setdefault(row.method, {})[row.cell] = row
    return {m: flown for m, flown in by_method.items() if len(flown) == len(TABLE2.cells)}


def table2_section(rows: Iterable[Row], *, is_as_published: bool) -> list[str]:
    """JSD by history and roadmap size, beside the paper's; nothing if no method flew it all."""
    flown = table2_rows(rows)
    if not flown:
        return []
    published = published_table2() if is_as_published else {}
    body = []
    for method, of in flown.items():
        body.append([method, *(plus_minus(of[c].figures["jsd"], "jsd") for c in TABLE2.cells)])
        name = TABLE2_ROWS.get(method, "")
        if name in published:
            paper = (f"{published[name][cell.num_nodes]:.3f}" for cell in TABLE2.cells)
            body.append([f"paper: {name}", *paper])
    return [
        "## Table II: JSD by roadmap size",
        "",
        "@T: how many decisions the network looks back. N = 4, r_v = 1/10.",
        "",
        *markdown_table(["method", *(f"V = {c.num_nodes}" for c in TABLE2.cells)], body),
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Covered:
    """One kind of world: the ends of the way in it, and the share of it that each planner covers.

    worst, bound: the ends' figures; shares: method -> unc and jsd -> share
    """

    cell: Cell
    worst: Row
    bound: Row
    shares: Mapping[str, Mapping[str, float]]


def ways_covered(rows: Iterable[Row]) -> list[Covered]:
    """Worlds in which both ends of the way were flown; nothing if all of one kind."""
    by_cell: dict[Cell, dict[str, Row]] = {}
    for row in rows:
        by_cell.setdefault(row.cell, {})[row.method] = row
    covered = [
        Covered(
            cell=cell,
            worst=of[WORST],
            bound=of[BOUND],
            shares={
                method: {
                    name: _share(*(r.figures[name].mean for r in (row, of[WORST], of[BOUND])))
                    for name in ("unc", "jsd")
                }
                for method, row in of.items()
                if method not in (WORST, BOUND)
            },
        )
        for cell, of in by_cell.items()
        if {WORST, BOUND} < of.keys()
    ]
    return covered if len({(of.cell.motion, of.cell.sensor) for of in covered}) > 1 else []


def _share(ours: float, worst: float, bound: float) -> float:
    """Of the way; NaN where there is hardly one."""
    return gap_closed(ours, worst, bound) if worst - bound > LEAST_WAY else math.nan


def _percent(share: float) -> str:
    return "" if math.isnan(share) else f"{100.0 * share:.0f} %"


def conditions_section(rows: Iterable[Row]) -> list[str]:
    """How much of the way from the lawnmower to the bound each planner covers, world by world."""
    covered = ways_covered(rows)
    if not covered:
        return []
    methods = list(dict.fromkeys(method for of in covered for method in of.shares))
    body = [
        [
            *(of.cell.motion, str(of.cell.sensor), of.cell.prior),
            *(str(of.cell.num_targets), str(of.cell.speed_ratio), str(of.cell.num_nodes)),
            *(
                " / ".join(number(end.figures[name].mean, name) for name in ("unc", "jsd"))
                for end in (of.worst, of.bound)
            ),
            *(
                " / ".join(_percent(share) for share in of.shares[method].values())
                if method in of.shares
                else ""
                for method in methods
            ),
        ]
        for of in covered
    ]
    return [
        f"## Other worlds: share of the way from {WORST} to {BOUND}, in Unc / JSD",
        "",
        *markdown_table([*WORLD, WORST, BOUND, *methods], body),
    ]


def priors_section(results: Sequence[Result]) -> list[str]:
    """Unc by third of the mission under each prior; nothing where only one was flown."""
    is_short = any(len(result.unc_over_time) < 3 for result in results)
    if len({result.cell.prior for result in results}) < 2 or is_short:
        return []
    groups: dict[tuple[Cell, str], list[Result]] = {}
    for result in results:
        groups.setdefault((result.cell, result.method), []).append(result)
    body = [
        [
            str(cell.num_targets),
            str(cell.speed_ratio),
            str(cell.num_nodes),
            cell.motion,
            str(cell.sensor),
            method,
            cell.prior,
            *(plus_minus(_over(group, _mean_of_third(k)), "unc") for k in range(3)),
            plus_minus(_over(group, lambda r: r.scores.min_ob), "min_ob"),
            *(plus_minus(_over(group, _found_after_third(k)), "found") for k in range(3)),
        ]
        for (cell, method), group in groups.items()
    ]
    thirds = ("first", "middle", "last")
    return [
        "## What is known at the start (Figure 5)",
        "",
        "Unc in each third of the mission, and the share of targets that were seen by its end.",
        "",
        *markdown_table(
            [
                *("N", "r_v", "V", "motion", "sensor", "method", "prior"),
                *(f"Unc, {third}" for third in thirds),
                "MinOb",
                *(f"found, {third}" for third in thirds),
            ],
            body,
        ),
    ]


def _over(group: Sequence[Result], value: Callable[[Result], float]) -> Estimate:
    return Estimate.of(float(value(result)) for result in group)


def _mean_of_third(third: int) -> Callable[[Result], float]:
    return lambda r: float(np.mean(np.array_split(r.unc_over_time, 3)[third]))


def _found_after_third(third: int) -> Callable[[Result], float]:
    return lambda r: float(np.array_split(r.found_over_time, 3)[third][-1])
