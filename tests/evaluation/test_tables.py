from __future__ import annotations

import csv
import math
from fractions import Fraction
from pathlib import Path

import pytest

from dronemon.belief import Scores
from dronemon.evaluation.options import CONDITIONS, FIGURE5, TABLE2, Cell
from dronemon.evaluation.report import write_tables
from dronemon.evaluation.results import Result
from dronemon.evaluation.tables import (
    TABLE1_CELLS,
    Estimate,
    average_by_cell,
    count_agreeing,
    count_better,
    gap_closed,
    overall,
    paired_differences,
    published_overall,
    published_rows,
)

CELL = Cell(prior="full", num_targets=2, speed_ratio=Fraction(1, 30))
OTHER = Cell(prior="full", num_targets=4, speed_ratio=Fraction(1, 10))


def result(
    method: str,
    seed: int,
    unc: float,
    *,
    cell: Cell = CELL,
    min_ob: int = 5,
    jsd: float = 0.2,
    code: str = "0.1.0+aaaaaaaaaa",
) -> Result:
    return Result(
        method=method,
        cell=cell,
        seed=seed,
        settings="x",
        scores=Scores(
            unc=unc,
            unc_std=0.1,
            lost=0.25,
            min_ob=min_ob,
            jsd=jsd,
            since_seen_au=1.0,
            peak_error_au=math.nan,
        ),
        unc_over_time=(unc, unc, unc + 0.1),
        found_over_time=(0.0, 0.5, 1.0),
        decisions=10,
        decision_s=0.002,
        code=code,
    )


def test_mean_and_standard_error_of_known_values() -> None:
    estimate = Estimate.of([1.0, 2.0, 3.0, 6.0])
    assert estimate.mean == 3.0
    assert estimate.standard_error == pytest.approx(math.sqrt((4 + 1 + 0 + 9) / 3 / 4))
    assert math.isnan(Estimate.of([1.0]).standard_error)
    assert Estimate.of([1.0, math.nan, 3.0]).mean == 2.0


def test_rows_are_means_per_method_and_cell() -> None:
    rows = average_by_cell(
        [
            result("a", 0, 0.5),
            result("b", 0, 0.9),
            result("a", 1, 0.7),
            result("a", 0, 0.1, cell=OTHER),
        ]
    )
    assert [(row.method, row.cell, row.instances) for row in rows] == [
        ("a", CELL, 2),
        ("b", CELL, 1),
        ("a", OTHER, 1),
    ]
    assert rows[0].figures["unc"].mean == pytest.approx(0.6)
    assert rows[0].figures["unc"].standard_error == pytest.approx(0.1)
    assert rows[0].decision_s == pytest.approx(0.002)


def test_published_table_is_the_papers() -> None:
    rows = published_rows()
    assert len(rows) == 48
    assert {row.cell for row in rows} == set(TABLE1_CELLS)
    (row,) = (row for row in rows if row.method == "TSP Loop" and row.cell == OTHER)
    assert (row.figures["unc"].mean, row.figures["jsd"].mean) == (0.869, 0.345)
    means = published_overall()["STAMP"]
    assert means["unc"] == pytest.approx(0.755, abs=5e-4)
    assert means["jsd"] == pytest.approx(0.237, abs=5e-4)


def test_overall_needs_all_sixteen_cells() -> None:
    results = [result("a", 0, 0.5 + 0.01 * k, cell=cell) for k, cell in enumerate(TABLE1_CELLS)]
    means = overall(results, "a")
    assert means is not None
    assert means["unc"].mean == pytest.approx(0.575)
    assert overall(results[1:], "a") is None


def test_error_of_a_mean_over_cells_is_that_of_the_seeds() -> None:
    # The seed decides all: sixteen cells tell no more than one.
    results = [
        result("a", seed, 0.5 + 0.1 * seed, cell=cell) for cell in TABLE1_CELLS for seed in range(3)
    ]
    means = overall(results, "a")
    assert means is not None
    assert means["unc"].mean == pytest.approx(0.6)
    assert means["unc"].standard_error == pytest.approx(0.1 / math.sqrt(3))


def test_gap_is_closed_where_ours_reaches_the_bound() -> None:
    assert gap_closed(0.7, 0.8, 0.7) == pytest.approx(1.0)
    assert gap_closed(0.8, 0.8, 0.7) == 0.0
    assert gap_closed(0.775, 0.8, 0.7) == pytest.approx(0.25)


def test_differences_pair_instances_and_weigh_cells_alike() -> None:
    results = [
        result("a", 0, 0.5),
        result("a", 1, 0.7),
        result("b", 0, 0.4),
        result("b", 1, 0.5),
        result("b", 2, 0.0),  # not flown by a
        *(result("a", seed, 0.9, cell=OTHER) for seed in (0, 1, 2)),
        *(result("b", seed, 0.8, cell=OTHER) for seed in (0, 1, 2)),
    ]
    (difference,) = paired_differences(results)
    assert (difference.method, difference.other, difference.cells) == ("a", "b", 2)
    assert difference.figures["unc"].mean == pytest.approx((0.15 + 0.1) / 2)
    assert difference.figures["unc"].standard_error == pytest.approx(0.05 / 2)


def test_better_counts_only_what_beats_every_published_method() -> None:
    # Best published in this cell: Unc 0.634 (STAMP), MinOb 59.24 (TSP Loop), JSD 0.070 (TSP Loop).
    won = average_by_cell([result("a", 0, 0.633, min_ob=60, jsd=0.069)])
    assert count_better(won, "a") == (3, 3, 0)
    tied = average_by_cell([result("a", 0, 0.634, min_ob=59, jsd=0.070)])
    assert count_better(tied, "a") == (0, 3, 0)
    close = [result("a", seed, 0.632 + 0.002 * seed, min_ob=60, jsd=0.01) for seed in (0, 1)]
    assert count_better(average_by_cell(close), "a") == (3, 3, 1)
    elsewhere = Cell(prior="none", num_targets=2, speed_ratio=Fraction(1, 30))
    assert count_better(average_by_cell([result("a", 0, 0.1, cell=elsewhere)]), "a") == (0, 0, 0)


def test_agreement_needs_unc_and_jsd_within_their_limits() -> None:
    # Published TSP Loop: 0.643 / 0.070.
    assert count_agreeing(average_by_cell([result("tsp", 0, 0.663, jsd=0.100)]), "tsp") == (1, 1)
    assert count_agreeing(average_by_cell([result("tsp", 0, 0.664, jsd=0.100)]), "tsp") == (0, 1)
    assert count_agreeing(average_by_cell([result("tsp", 0, 0.643, jsd=0.101)]), "tsp") == (0, 1)


def test_files_hold_ours_beside_the_papers(tmp_path: Path) -> None:
    results = [
        result(method, seed, unc + 0.01 * seed, cell=cell)
        for cell in TABLE1_CELLS
        for seed in (0, 1)
        for method, unc in (("search", 0.7), ("clairvoyant-search", 0.65))
    ]
    verdicts = write_tables(results, tmp_path, "dronemon evaluate --table1", is_as_published=True)
    with (tmp_path / "table.csv").open(newline="") as file:
        records = list(csv.DictReader(file))
    assert list(records[0])[:7] == [
        "targets",
        "speed_ratio",
        "method",
        "unc",
        "unc_std",
        "min_ob",
        "jsd",
    ]
    assert len(records) == 16 * 2 + 48
    first = records[0]
    assert (first["targets"], first["speed_ratio"], first["method"]) == ("2", "1/30", "search")
    assert (first["unc"], first["unc_se"], first["instances"]) == ("0.7050", "0.0050", "2")
    assert first["peak_error_au"] == ""
    text = (tmp_path / "table.md").read_text()
    network = sum(r.figures["unc"].mean for r in published_rows() if r.method == "STAMP") / 16
    share = 100 * (network - 0.705) / (network - 0.655)
    assert f"`search` closes the gap from the paper's network: {share:.0f} % in Unc" in text
    assert all(f"\n- {verdict}\n" in text for verdict in verdicts)
    assert "`dronemon evaluate --table1`" in text
    assert "paper: STAMP" in text
    assert "search minus clairvoyant-search | 16 | 0.050 ± 0.000" in text
    assert "\ndronemon 0.1.0+aaaaaaaaaa; one instance per seed, 0 to 1" in text


def test_other_conditions_than_the_papers_are_not_compared_with_it(tmp_path: Path) -> None:
    results = [result("search", 0, 0.7, cell=cell) for cell in TABLE1_CELLS]
    assert write_tables(results, tmp_path, "--horizon 5", is_as_published=False) == []
    assert "paper" not in (tmp_path / "table.md").read_text()


def test_table_2_stands_beside_the_papers(tmp_path: Path) -> None:
    results = [
        result(method, seed, 0.7, cell=cell, jsd=0.3 + 0.02 * seed)
        for cell in TABLE2.cells
        for seed in (0, 1)
        for method in ("stamp:paper@25", "tsp")
    ]
    results.append(result("lawnmower", 0, 0.8, cell=TABLE2.cells[0]))  # not in all of its cells
    write_tables(results, tmp_path, "--table2", is_as_published=True)
    text = (tmp_path / "table.md").read_text()
    (part,) = (p for p in text.split("\n## ") if p.startswith("Table II"))
    ours, papers, others, *_ = part.splitlines()[6:]
    assert ours.startswith("| stamp:paper@25 | 0.310 ± 0.010 |")
    assert papers == "| paper: 25 | 0.301 | 0.296 | 0.297 | 0.292 | 0.304 | 0.296 |"
    assert others.startswith("| tsp | 0.310 ± 0.010 |")
    assert "lawnmower" not in part
    write_tables(results, tmp_path, "--table2 --horizon 2", is_as_published=False)
    assert "paper: 25" not in (tmp_path / "table.md").read_text()


def test_priors_are_compared_by_thirds_of_the_mission(tmp_path: Path) -> None:
    results = [
        result("search", seed, 0.6 + 0.02 * seed, cell=cell)
        for cell in FIGURE5.cells
        for seed in (0, 1)
    ]
    write_tables(results, tmp_path, "--figure5", is_as_published=True)
    text = (tmp_path / "table.md").read_text()
    (part,) = (p for p in text.split("\n## ") if p.startswith("What is known at the start"))
    row = "0.610 ± 0.010 | 0.610 ± 0.010 | 0.710 ± 0.010 | 5.00 ± 0.00 | 0.000 ± 0.000 | "
    assert (
        f"| 6 | 1/20 | 200 | tsp | perfect | search | none | {row}0.500 ± 0.000 | 1.000 ± 0.000 |"
        in part
    )
    write_tables(results[:2], tmp_path, "one prior", is_as_published=True)
    assert "What is known" not in (tmp_path / "table.md").read_text()


def test_tables_name_every_code_that_took_part(tmp_path: Path) -> None:
    mixed = [result("tsp", seed, 0.5, code=f"0.1.0+{letter}") for seed, letter in enumerate("bab")]
    write_tables(mixed, tmp_path, "dronemon evaluate", is_as_published=True)
    assert "\ndronemon 0.1.0+a and 0.1.0+b; one" in (tmp_path / "table.md").read_text()


def test_other_worlds_are_told_as_shares_of_the_way_to_the_bound(tmp_path: Path) -> None:
    figures = {"lawnmower": (0.8, 0.35), "search": (0.725, 0.2), "clairvoyant-search": (0.7, 0.15)}
    results = [
        result(method, seed, unc, jsd=jsd, cell=cell)
        for cell in CONDITIONS.cells
        for seed in (0, 1)
        for method, (unc, jsd) in figures.items()
    ]
    write_tables(results, tmp_path, "--conditions", is_as_published=True)
    text = (tmp_path / "table.md").read_text()
    (part,) = (p for p in text.split("\n## ") if p.startswith("Other worlds"))
    rows = [line for line in part.splitlines() if line.endswith("| 75 % / 75 % |")]
    assert len(rows) == len(CONDITIONS.cells) == 72
    assert "| loop | miss=0.1+false_alarms=0.05 | none | 4 | 1/10 | 200 | 0.800 / 0.350 |" in part
    (tmp_path / "one").mkdir()
    alone = [r for r in results if r.cell == CONDITIONS.cells[0]]
    write_tables(alone, tmp_path / "one", "", is_as_published=True)
    assert "Other worlds" not in (tmp_path / "one" / "table.md").read_text()


def test_worlds_and_eyes_are_read_again_from_results() -> None:
    for cell in CONDITIONS.cells:
        one = result("search", 0, 0.7, cell=cell)
        assert Result.from_json(one.as_json()) == one
