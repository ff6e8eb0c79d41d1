"""Tables on disk: table.csv, paired.csv and over_time.csv for programs, table.md for people."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from dronemon.evaluation.markdown import markdown_table, number, plus_minus
from dronemon.evaluation.options import DEFAULT_NODES, Cell
from dronemon.evaluation.results import Result
from dronemon.evaluation.sections import conditions_section, priors_section, table2_section
from dronemon.evaluation.tables import (
    AGREEMENT,
    BOUND,
    COUNTERPARTS,
    FIGURES,
    PAPER_FIGURES,
    PAPER_NETWORK,
    RANKED,
    Difference,
    Estimate,
    Row,
    average_by_cell,
    count_agreeing,
    count_better,
    gap_closed,
    grouped,
    overall,
    paired_differences,
    published_overall,
    published_rows,
)
from dronemon.problem import MEASUREMENT_INTERVAL_AU, Prior
from dronemon.sensor import Sensor

UNKNOWN = Estimate(mean=math.nan, standard_error=math.nan)


def write_tables(
    results: Sequence[Result],
    out: Path,
    command: str,
    *,
    is_as_published: bool,
    kept: Sequence[str] = (),
) -> list[str]:
    """Write table.csv, paired.csv, over_time.csv and table.md into a folder.

    command:         made the results
    kept:            methods whose results are from earlier runs
    is_as_published: episodes are as long as the paper's; its figures are added
    -> what follows from that comparison, a line each
    """
    rows = average_by_cell(results)
    cells = {row.cell for row in rows}
    published = [
        replace(row, method=f"paper: {row.method}")  # not to be mistaken for ours
        for row in published_rows()
        if row.cell in cells and is_as_published
    ]
    differences = paired_differences(results)
    _write_csv(out / "table.csv", _table_records([*rows, *published]))
    _write_csv(out / "paired.csv", _difference_records(differences))
    _write_csv(out / "over_time.csv", _curve_records(results))
    verdicts = _verdicts(results, rows) if is_as_published else []
    text = [
        *_title(results, command, kept),
        *_means(results, is_as_published),
        *[f"- {verdict}" for verdict in verdicts],
        "",
        *table2_section(rows, is_as_published=is_as_published),
        *priors_section(results),
        *conditions_section(rows),
        *_cell_tables(rows, published),
        *_paired(differences),
    ]
    (out / "table.md").write_text("\n".join(text), encoding="utf-8")
    return verdicts


def _title(results: Sequence[Result], command: str, kept: Sequence[str]) -> list[str]:
    """What was flown, by which code."""
    seeds = [result.seed for result in results]
    codes = sorted({result.code for result in results})
    return [
        "# Evaluation",
        "",
        f"`{command}`",
        "",
        *([f"Besides, from earlier runs in this folder: {', '.join(kept)}", ""] if kept else []),
        f"dronemon {' and '.join(codes)}; one instance per seed, {min(seeds)} to {max(seeds)}; "
        "mean ± standard error over instances.",
        "",
    ]


def _write_csv(path: Path, records: list[dict[str, str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        if records:
            writer = csv.DictWriter(file, list(records[0]))
            writer.writeheader()
            writer.writerows(records)


def _table_records(rows: Iterable[Row]) -> list[dict[str, str]]:
    """Columns of the paper's table first, then standard errors and what else was measured."""
    others = [name for name in FIGURES if name not in PAPER_FIGURES]
    return [
        {
            **_which(row.cell, row.method),
            **_columns(row, PAPER_FIGURES),
            **_world(row.cell),
            "instances": str(row.instances) if row.instances else "",
            **_columns(row, others),
            "decision_ms": number(row.decision_s * 1e3, "decision_ms"),
        }
        for row in rows
    ]


def _which(cell: Cell, method: str) -> dict[str, str]:
    """What the paper's table goes by, as columns."""
    return {
        "targets": str(cell.num_targets),
        "speed_ratio": str(cell.speed_ratio),
        "method": method,
    }


def _world(cell: Cell) -> dict[str, str]:
    """What else a cell is, as columns."""
    return {
        "prior": cell.prior,
        "nodes": str(cell.num_nodes),
        "motion": cell.motion,
        "sensor": str(cell.sensor),
    }


def _curve_records(results: Iterable[Result]) -> list[dict[str, str]]:
    """What figures over time show: means over instances at each measurement."""
    return [
        {
            **_which(cell, method),
            **_world(cell),
            "time_au": f"{MEASUREMENT_INTERVAL_AU * (step + 1):.1f}",
            **_estimated("unc", (result.unc_over_time[step] for result in group)),
            **_estimated("found", (result.found_over_time[step] for result in group)),
        }
        for (cell, method), group in grouped(results).items()
        for step in range(min(len(result.found_over_time) for result in group))
    ]


def _estimated(name: str, values: Iterable[float]) -> dict[str, str]:
    """A figure's mean over instances and its error, as columns."""
    of = Estimate.of(values)
    return {
        name: number(of.mean, name, extra_digits=1),
        f"{name}_se": number(of.standard_error, name, extra_digits=1),
    }


def _columns(row: Row, names: Sequence[str]) -> dict[str, str]:
    """Figures of a row, then their standard errors."""
    extra = 1 if row.instances else 0
    figures = {name: row.figures.get(name, UNKNOWN) for name in names}
    means = {n: number(value.mean, n, extra_digits=extra) for n, value in figures.items()}
    errors = {n: number(value.standard_error, n, extra_digits=1) for n, value in figures.items()}
    return {**means, **{f"{name}_se": text for name, text in errors.items()}}


def _difference_records(differences: Iterable[Difference]) -> list[dict[str, str]]:
    return [
        {
            "method": difference.method,
            "minus": difference.other,
            "cells": str(difference.cells),
            **{
                f"{name}{end}": number(value, name, extra_digits=1)
                for name, estimate in difference.figures.items()
                for end, value in (("", estimate.mean), ("_se", estimate.standard_error))
            },
        }
        for difference in differences
    ]


def _means(results: Sequence[Result], is_as_published: bool) -> list[str]:
    """Means over the paper's cells, beside the paper's own; nothing if no method flew them all."""
    methods = dict.fromkeys(result.method for result in results)
    body = [
        [method, *(plus_minus(mean[name], name) for name in PAPER_FIGURES)]
        for method in methods
        if (mean := overall(results, method))
    ]
    if not body:
        return []
    if is_as_published:
        body += [
            [f"paper: {method}", *(number(mean[name], name) for name in PAPER_FIGURES)]
            for method, mean in published_overall().items()
        ]
    return [
        "## Means over the 16 cells of Table I",
        "",
        *markdown_table(["method", "Unc", "Unc std", "MinOb", "JSD"], body),
    ]


def _verdicts(results: Sequence[Result], rows: Sequence[Row]) -> list[str]:
    """What the comparison with the paper's figures comes to."""
    methods = list(dict.fromkeys(row.method for row in rows))
    means = {method: overall(results, method) for method in methods}
    bound, network = means.get(BOUND), published_overall()[PAPER_NETWORK]
    lines: list[str] = []
    if bound:
        for method, mean in means.items():
            if mean and method != BOUND:
                shares = ", ".join(
                    f"{100 * gap_closed(mean[name].mean, network[name], bound[name].mean):.0f}"
                    f" % in {name.title() if name == 'unc' else name.upper()}"
                    for name in ("unc", "jsd")
                )
                lines.append(f"`{method}` closes the gap from the paper's network: {shares}.")
    for method in methods:
        better, compared, close = count_better(rows, method)
        if compared:
            narrowly = f", {close} of them within its standard error" if close else ""
            lines.append(
                f"`{method}` is better than the best published of any method in {better} of "
                f"{compared} figures{narrowly}."
            )
        if method in COUNTERPARTS:
            agreeing, compared = count_agreeing(rows, method)
            if compared:
                lines.append(
                    f"`{method}` agrees with the paper's {COUNTERPARTS[method]} in {agreeing} of "
                    f"{compared} cells (Unc within {AGREEMENT['unc']}, JSD within "
                    f"{AGREEMENT['jsd']})."
                )
    return lines


def _cell_tables(rows: Sequence[Row], published: Sequence[Row]) -> list[str]:
    """Tables per prior and number of targets: a line per method, a column per speed ratio."""
    lines: list[str] = []
    groups: dict[tuple[str, Sensor, Prior, int], list[Cell]] = {}
    for cell in dict.fromkeys(row.cell for row in rows):
        world = cell.motion, cell.sensor, cell.prior, cell.num_targets
        groups.setdefault(world, []).append(cell)
    by_method: dict[str, dict[Cell, Row]] = {}
    for row in [*rows, *published]:
        by_method.setdefault(row.method, {})[row.cell] = row
    for (motion, sensor, prior, count), cells in groups.items():
        moving = "" if motion == "tsp" else f", motion: {motion}"
        seeing = "" if sensor.is_perfect else f", sensor: {sensor}"
        lines += [f"## N = {count}, prior: {prior}{moving}{seeing}", ""]
        for name, title in (
            ("unc", "Unc (standard deviation between targets)"),
            ("min_ob", "MinOb"),
            ("jsd", "JSD"),
            ("lost", "Lost: share of targets and instants with Unc above 0.9"),
        ):
            lines += [f"{title}", ""]
            header = ["method", *(_heading(cell) for cell in cells)]
            body = [
                [method, *(_entry(row_of.get(cell), name) for cell in cells)]
                for method, row_of in by_method.items()
                if any(name in row_of[cell].figures for cell in cells if cell in row_of)
            ]
            lines += markdown_table(header, body)
    return lines


def _heading(cell: Cell) -> str:
    nodes = "" if cell.num_nodes == DEFAULT_NODES else f", V = {cell.num_nodes}"
    return f"r_v = {cell.speed_ratio}{nodes}"


def _entry(row: Row | None, name: str) -> str:
    """One figure of one method in one cell."""
    if row is None or name not in row.figures:
        return ""
    spread = f" ({number(row.figures['unc_std'].mean, 'unc_std')})" if name == "unc" else ""
    return plus_minus(row.figures[name], name) + spread


def _paired(differences: Sequence[Difference]) -> list[str]:
    """Differences between our planners on the same instances."""
    if not differences:
        return []
    body = [
        [
            f"{difference.method} minus {difference.other}",
            str(difference.cells),
            *(plus_minus(difference.figures[name], name) for name in RANKED),
        ]
        for difference in differences
    ]
    return [
        "## Paired differences",
        "",
        "On the same instances, mean over cells; below zero: the first is lower.",
        "",
        *markdown_table(["methods", "cells", "Unc", "MinOb", "JSD"], body),
    ]
