from __future__ import annotations

import csv
import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from dronemon.belief import episode_metrics
from dronemon.errors import OptionError, RecordError
from dronemon.evaluation.command import evaluate_command
from dronemon.evaluation.evaluate import evaluate
from dronemon.evaluation.options import Options, PlannerSpec, Sweep
from dronemon.evaluation.results import Result, load_results
from dronemon.terminal import LenientConsole
from dronemon.version import code_version

QUIET = LenientConsole(quiet=True)
PROGRAM = (
    "import typer; from dronemon.evaluation.command import evaluate_command; "
    "app = typer.Typer(); app.command()(evaluate_command); app()"
)


@pytest.fixture(name="without_figures")
def _without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["dronemon.evaluation.evaluate"], "_draw", lambda *_: None)


without_figures = pytest.mark.usefixtures("without_figures")
"""For what is not about figures, which take longer to draw than short episodes to fly."""


def options(out: Path, **changes: Any) -> Options:
    given: dict[str, Any] = {
        "planners": (PlannerSpec(kind="lawnmower"), PlannerSpec(kind="tsp")),
        "out": out,
        "sweep": sweep(),
        "instances": 2,
        "first_seed": 10_000,
        "horizon_au": 2.0,
    }
    return Options(**{**given, **changes})


def sweep(**changes: Any) -> Sweep:
    return Sweep(**{"targets": (2,), "nodes": (20,), **changes})


def outcome(results: list[Result]) -> list[tuple[object, ...]]:
    """All but the time that decisions took."""
    return [(*result.key, result.scores, result.unc_over_time) for result in results]


@without_figures
@pytest.mark.slow
def test_results_do_not_depend_on_processes(tmp_path: Path) -> None:
    alone = evaluate(options(tmp_path / "alone"), QUIET)
    together = evaluate(options(tmp_path / "together", workers=2), QUIET)
    assert outcome(alone) == outcome(together)


@without_figures
def test_results_do_not_depend_on_what_else_is_flown(tmp_path: Path) -> None:
    alone = evaluate(options(tmp_path / "alone"), QUIET)
    later = evaluate(
        options(tmp_path / "later", first_seed=10_001, instances=1, sweep=sweep(targets=(3, 2))),
        QUIET,
    )
    assert outcome(alone)[2:] == [row for row in outcome(later) if row[1] == alone[0].cell]


@pytest.mark.lengthy
def test_run_leaves_tables_figures_and_arrays_that_others_can_check(tmp_path: Path) -> None:
    asked = sweep(priors=("full", "none"))
    result, *_ = evaluate(options(tmp_path, sweep=asked, instances=1, save_episodes=True), QUIET)
    for name in ("table.md", "table.csv", "paired.csv", "over_time.csv", "results.jsonl"):
        assert (tmp_path / name).is_file()
    for name in ("unc_over_time", "found_over_time", "traces", "overview"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert b"<svg" in (tmp_path / f"{name}.svg").read_bytes()
    overview = (tmp_path / "overview.svg").read_text()
    assert "<!-- lawnmower: " in overview
    assert "<!-- tsp: " in overview
    (path,) = (tmp_path / "episodes").glob("lawnmower*full*")
    with np.load(path) as arrays:
        assert arrays["agent_au"].shape == (21, 2)
        assert arrays["targets_au"].shape == (21, 2, 2)
        offsets = arrays["targets_au"] - arrays["agent_au"][:, None]
        in_view = np.linalg.norm(offsets, axis=-1) < 0.1
        np.testing.assert_array_equal(
            arrays["told_au"][1:], np.where(in_view[..., None], arrays["targets_au"], np.nan)[1:]
        )
        again = episode_metrics(
            0.1 * np.arange(21), arrays["agent_au"], arrays["targets_au"], arrays["told_au"]
        )
        np.testing.assert_allclose(arrays["unc"], again.unc)
        np.testing.assert_allclose(arrays["jsd"], again.jsd)
        assert result.scores.unc == pytest.approx(arrays["unc"][1:].mean())


@without_figures
def test_finished_episodes_are_not_flown_again(tmp_path: Path) -> None:
    first = evaluate(options(tmp_path), QUIET)
    lines = (tmp_path / "results.jsonl").read_text().splitlines()
    more = evaluate(options(tmp_path, instances=3), QUIET)
    assert (tmp_path / "results.jsonl").read_text().splitlines()[: len(lines)] == lines
    assert outcome(more)[:4] == outcome(first)
    assert len(more) == 6


@without_figures
def test_curves_are_means_over_instances(tmp_path: Path) -> None:
    results = evaluate(options(tmp_path), QUIET)
    with (tmp_path / "over_time.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["time_au"]) for row in rows] == [round(0.1 * n, 1) for n in range(1, 21)] * 2
    for method in ("lawnmower", "tsp"):
        of = [row for row in rows if row["method"] == method]
        for name, curve in (("unc", "unc_over_time"), ("found", "found_over_time")):
            flown = np.array([getattr(r, curve) for r in results if r.method == method])
            told = [[float(row[name]), float(row[f"{name}_se"])] for row in of]
            expected = np.stack(
                [flown.mean(axis=0), flown.std(axis=0, ddof=1) / np.sqrt(2)], axis=1
            )
            np.testing.assert_allclose(told, expected, atol=6e-5)


@without_figures
def test_planners_of_an_earlier_run_stay_in_the_table(tmp_path: Path) -> None:
    tsp, lawnmower = PlannerSpec(kind="tsp"), PlannerSpec(kind="lawnmower")
    first = evaluate(options(tmp_path, planners=(tsp,), sweep=sweep(targets=(2, 3))), QUIET)
    evaluate(options(tmp_path, planners=(tsp,), horizon_au=2.5), QUIET)
    both = evaluate(options(tmp_path, planners=(lawnmower,)), QUIET)
    assert [result.method for result in both] == ["lawnmower"] * 2 + ["tsp"] * 2
    assert outcome(both[2:]) == [row for row in outcome(first) if row[1] == both[0].cell]
    said = (tmp_path / "table.md").read_text()
    assert "| lawnmower minus tsp | 1 |" in said
    assert "from earlier runs in this folder: tsp" in said


@without_figures
def test_a_history_is_a_row_and_its_command_makes_it_again(tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(evaluate_command)
    asked = ["--planner", "stamp,stamp@3,tsp", "--history", "1,5", "--instances", "1"]
    asked += ["--horizon", "1", "--nodes", "12,15", "--workers", "1", "--targets", "1"]
    done = CliRunner().invoke(app, [*asked, "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    flown = load_results(tmp_path / "results.jsonl").values()
    assert {(r.method, r.cell.num_nodes) for r in flown} == {
        (method, nodes) for method in ("stamp@1", "stamp@5", "stamp@3", "tsp") for nodes in (12, 15)
    }
    assert "--planner stamp@1,stamp@5,stamp@3,tsp" in (tmp_path / "table.md").read_text()


def test_a_planner_is_read_as_it_is_written() -> None:
    for text in ("stamp", "stamp@25", "stamp:a/b.pt", "stamp:a@b.pt@7", "tsp", "my.module:Class"):
        assert PlannerSpec.parse(text).text == text
    assert PlannerSpec.parse("stamp:a/b.pt@7").method == "stamp:b@7"
    assert PlannerSpec.parse("stamp:a@b.pt@7") == PlannerSpec(
        kind="stamp", checkpoint="a@b.pt", history=7
    )


@without_figures
def test_line_that_was_cut_off_is_flown_again(tmp_path: Path) -> None:
    first = evaluate(options(tmp_path), QUIET)
    path = tmp_path / "results.jsonl"
    path.write_bytes(path.read_bytes()[:-30])
    assert outcome(evaluate(options(tmp_path), QUIET)) == outcome(first)
    assert len(load_results(path)) == 4


@without_figures
def test_other_settings_are_other_episodes(tmp_path: Path) -> None:
    evaluate(options(tmp_path), QUIET)
    longer = evaluate(options(tmp_path, horizon_au=2.5), QUIET)
    assert len(longer[0].unc_over_time) == 25
    assert len((tmp_path / "results.jsonl").read_text().splitlines()) == 8


@without_figures
def test_episodes_of_other_code_are_kept_and_named(tmp_path: Path) -> None:
    first = evaluate(options(tmp_path), QUIET)
    assert {result.code for result in first} == {code_version()}
    path = tmp_path / "results.jsonl"
    records = [json.loads(line) for line in path.read_text().splitlines()]
    records[0]["code"] = "0.1.0+0123456789"
    del records[1]["code"]  # as written before results named it
    path.write_text("".join(json.dumps(record) + "\n" for record in records))
    console = LenientConsole(file=io.StringIO())
    again = evaluate(options(tmp_path, instances=3), console)
    assert outcome(again)[:4] == outcome(first)
    printed = console.file.getvalue()  # type: ignore[attr-defined]
    assert printed.startswith("warning: 2 finished episodes in ")
    assert f"(0.1.0+0123456789 and unknown; running now: {code_version()})" in printed
    assert "take a fresh --out" in printed
    versions = " and ".join(sorted({"0.1.0+0123456789", "unknown", code_version()}))
    assert f"\ndronemon {versions}; one" in (tmp_path / "table.md").read_text()


@without_figures
def test_episodes_of_the_same_code_give_no_warning(tmp_path: Path) -> None:
    evaluate(options(tmp_path), QUIET)
    console = LenientConsole(file=io.StringIO())
    evaluate(options(tmp_path), console)
    assert "warning" not in console.file.getvalue()  # type: ignore[attr-defined]


@without_figures
def test_damaged_lines_are_named(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    one = options(tmp_path, planners=(PlannerSpec(kind="tsp"),), instances=1, horizon_au=0.3)
    evaluate(one, QUIET)
    line = path.read_bytes()
    record = json.loads(line)
    for wrong in (
        b'{"method": "tsp"}',
        b"\xff\xfe",
        json.dumps(record | {"speed_ratio": "1/0"}).encode(),
        json.dumps(record | {"scores": record["scores"] | {"unc": "x"}}).encode(),
        json.dumps(record | {"unc_over_time": []}).encode(),
        json.dumps(record | {"unc_over_time": ["x"]}).encode(),
    ):
        path.write_bytes(line + wrong + b"\n")
        with pytest.raises(RecordError, match=r"results\.jsonl:2 is no finished episode"):
            evaluate(one, QUIET)


@without_figures
@pytest.mark.parametrize("name", ["results.jsonl", "table.md"])
def test_what_cannot_be_written_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(RecordError, match=rf"{name}: .*[Ii]s a directory"):
        evaluate(options(tmp_path, instances=1, horizon_au=0.3), QUIET)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "exit_code"), [(signal.SIGTERM, 130), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_run_that_was_ended_leaves_no_process_and_goes_on_where_it_was(
    tmp_path: Path, end: signal.Signals, exit_code: int
) -> None:
    arguments = ["--planner", "tsp", "--targets", "2", "--speed", "1/10", "--workers", "2"]
    arguments += ["--instances", "4000", "--first-seed", "10000", "--horizon", "2", "--nodes", "20"]
    out = tmp_path / "out"
    path = out / "results.jsonl"
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments, "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        while process.poll() is None and (not path.exists() or path.stat().st_size < 2000):
            os.sched_yield()
        process.send_signal(end)
        said, _ = process.communicate(timeout=30.0)  # until all who hold the pipe are gone
    assert process.returncode == exit_code, said
    if end == signal.SIGTERM:
        assert said.splitlines()[-1].startswith(f"stopped; finished episodes are in {out}"), said
        assert "Traceback" not in said
    done = len(load_results(path))
    assert 0 < done < 4000, said
    kept = path.read_bytes()
    wanted = options(out, planners=(PlannerSpec(kind="tsp"),), instances=done + 2)
    results = evaluate(wanted, QUIET)
    assert len(results) == done + 2
    assert path.read_bytes().startswith(kept)
    assert len({json.loads(line)["seed"] for line in path.read_text().splitlines()}) >= done + 2
    fresh = evaluate(options(tmp_path / "fresh", planners=wanted.planners, instances=2), QUIET)
    assert outcome(results)[:2] == outcome(fresh)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--planner", "tsq"], "did you mean tsp?"),
        (["--planner", "tsp,tsp"], "names one twice"),
        (["--planner", ""], "--planner is empty"),
        (["--targets", "0"], "--targets 0 is not 1 to 100"),
        (["--targets", "four"], "--targets four"),
        (["--speed", "1/0"], "--speed 1/0"),
        (["--speed", "2"], "--speed 2 is not"),
        (["--prior", "half"], "--prior half is none of full, number, none"),
        (["--instances", "0"], "--instances 0 is less than 1"),
        (["--first-seed", "-1"], "--first-seed -1 is less than 0"),
        (["--horizon", "nan"], "--horizon nan is not"),
        (["--nodes", "3"], "--nodes 3 is not"),
        (["--workers", "0"], "--workers 0 is less than 1"),
        (["--table1", "--targets", "4"], "--table1 sets --targets"),
        (["--table2", "--nodes", "50"], "--table2 sets --targets"),
        (["--table1", "--figure5"], "no other of"),
        (["--planner", "tsp", "--history", "5"], "--history 5: no planner of tsp looks back"),
        (["--planner", "tsp@5"], "'tsp' has no weights, but history 5 was given"),
        (["--planner", "stamp", "--history", "0"], "a history of 0 is not 1 to 1000"),
        (["--planner", "stamp", "--history", "few"], "--history few"),
    ],
)
def test_bad_input_is_refused_with_the_reason(
    tmp_path: Path, arguments: list[str], complaint: str
) -> None:
    app = typer.Typer()
    app.command()(evaluate_command)
    outcome = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    assert isinstance(outcome.exception, OptionError)
    assert outcome.exception.exit_code == 2
    assert complaint in str(outcome.exception)
    assert not (tmp_path / "out").exists()


@without_figures
def test_command_writes_where_it_was_told(tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(evaluate_command)
    arguments = ["--planner", "lawnmower", "--instances", "1", "--horizon", "0.5", "--workers", "1"]
    outcome = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path)])
    assert outcome.exit_code == 0, outcome.output
    assert "## N = 4, prior: full" in (tmp_path / "table.md").read_text()
