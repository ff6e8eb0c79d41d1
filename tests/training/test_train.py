"""Runs of training: they log what is defined, can be killed at any point, and go on as if not."""

from __future__ import annotations

import csv
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import typer
from simulated_vehicle import StartProgram
from typer.testing import CliRunner

from dronemon.errors import CheckpointMismatch, OptionError
from dronemon.policy import NetworkConfig, load_checkpoint, read_tensors
from dronemon.training.command import train_command
from dronemon.training.imitation import ExpertConfig
from dronemon.training.peers import Peers
from dronemon.training.ppo import PpoConfig
from dronemon.training.recipe import Recipe, load_recipe
from dronemon.training.train import METRICS, METRICS_FILE, Plan, train

ALONE = Peers(device=torch.device("cpu"))
SMALL = NetworkConfig(
    width=16, num_heads=2, feed_forward=24, newest=True, ways=True, geometry=True, tracks=True
)
PAPER = PpoConfig(
    episodes_per_iteration=3,
    decisions=12,
    epochs=2,
    minibatch_episodes=2,
    num_nodes=(20, 30),
    history=(8, 12),
)
EXPERT = ExpertConfig(
    round_episodes=2,
    lesson_episodes=1,
    decisions=8,
    updates=2,
    num_nodes=(20, 30),
    history=(8, 12),
    num_targets=(2, 3),
    priors=("full", "number", "none"),
    teacher_drawn=20,
    teacher_refined=10,
    finish=replace(PAPER, objective="unc"),
)
RECIPES = {
    "ppo": Recipe(learner="ppo", network=SMALL, settings=PAPER),
    "expert": Recipe(learner="expert", network=SMALL, settings=EXPERT),
}


class Stop(Exception):
    """What a test kills a run with."""


def make_plan(out: Path, **changes: object) -> Plan:
    plan = Plan(
        out=out,
        recipe=RECIPES["ppo"],
        minutes=1e6,
        num_workers=1,
        validation_minutes=0.0,
        validation_episodes=1,
        validation_decisions=5,
    )
    return replace(plan, **changes)


def run(plan: Plan, iterations: int) -> None:
    """Train until so many iterations are recorded, then stop as a kill would."""

    def listen(progress: float, metrics: Mapping[str, float]) -> None:
        assert progress >= 0.0
        assert metrics.keys() <= METRICS.keys()
        if metrics["iteration"] >= iterations:
            raise Stop

    with pytest.raises(Stop):
        train(plan, ALONE, command="test", listen=listen)


def logged(folder: Path) -> list[dict[str, float]]:
    """What a run logged of each iteration."""
    with (folder / METRICS_FILE).open(newline="") as file:
        rows = csv.DictReader(file)
        assert rows.fieldnames == list(METRICS)
        return [{name: float(x) for name, x in row.items() if x} for row in rows]


def test_the_page_defines_every_number_that_is_logged() -> None:
    page = (Path(__file__).parents[2] / "docs" / "training.md").read_text()
    assert re.findall(r"(?m)^\| `(\w+)` \| (.*) \|$", page) == list(METRICS.items())


@pytest.fixture(scope="module")
def first_iteration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was stopped after its first iteration, to be copied."""
    folder = tmp_path_factory.mktemp("first") / "run"
    run(make_plan(folder), 1)
    return folder


@pytest.mark.slow
def test_several_recipes_are_trained_one_after_another_each_to_its_end(tmp_path: Path) -> None:
    names = []
    for learner, recipe in RECIPES.items():
        names.append(str(tmp_path / f"{learner}.yaml"))
        Path(names[-1]).write_text(recipe.text)
    app = typer.Typer()
    app.command()(train_command)
    asked = ["--recipe", ", ".join(names), "--minutes", "0.1", "--validation-episodes", "1"]
    asked += ["--workers", "1", "--device", "cpu", "--out", str(tmp_path / "out")]
    for _ in range(2):  # the second time nothing is left to do
        done = CliRunner().invoke(app, asked)
        assert done.exit_code == 0, done.output
        assert done.output.count("best weights: ") == 2
    for learner in RECIPES:
        validated = ["val_unc" in row for row in logged(tmp_path / "out" / learner)]
        assert validated == [False] * (len(validated) - 1) + [True]


@pytest.mark.slow
@pytest.mark.parametrize("learner", ["ppo", "expert"])
def test_a_resumed_run_equals_one_that_was_never_interrupted(learner: str, tmp_path: Path) -> None:
    recipe = RECIPES[learner]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    run(make_plan(whole, recipe=recipe), 2)
    run(make_plan(parts, recipe=recipe), 1)
    run(make_plan(parts, recipe=recipe), 2)
    expected, found = (read_tensors(folder / "state.pt") for folder in (whole, parts))
    for name, value in expected["weights"].items():
        torch.testing.assert_close(found["weights"][name], value, rtol=0.0, atol=0.0)
    best, again = (load_checkpoint(f / "best.pt").network.state_dict() for f in (whole, parts))
    for name, value in best.items():
        torch.testing.assert_close(again[name], value, rtol=0.0, atol=0.0)
    assert [row["iteration"] for row in logged(parts)] == [1, 2]


def test_the_expert_ends_with_ppo(tmp_path: Path) -> None:
    recipe = replace(RECIPES["expert"], settings=replace(EXPERT, imitation_share=0.0))
    plan = make_plan(tmp_path, recipe=recipe)
    run(plan, 1)
    (row,) = logged(tmp_path)
    assert "kl" in row
    assert "imitation_loss" not in row


@pytest.mark.lengthy
def test_the_best_weights_are_kept_with_their_card(tmp_path: Path) -> None:
    run(make_plan(tmp_path), 2)
    best = load_checkpoint(tmp_path / "best.pt", expected=SMALL)
    state = read_tensors(tmp_path / "state.pt")
    assert best.card.scores["val_unc"] == pytest.approx(state["run"]["best_unc"])
    assert best.card.scores["val_unc"] == min(row["val_unc"] for row in state["run"]["curve"])
    assert "val_unc" in (tmp_path / "best.md").read_text()


@pytest.mark.lengthy
def test_a_run_can_begin_with_other_weights(first_iteration: Path, tmp_path: Path) -> None:
    start = str(first_iteration / "best.pt")
    run(make_plan(tmp_path / "second", start=start), 1)
    wider = replace(RECIPES["ppo"], network=replace(SMALL, width=32))
    with pytest.raises(CheckpointMismatch, match="its width is 16, not 32"):
        train(
            make_plan(tmp_path / "third", start=start, recipe=wider),
            ALONE,
            command="test",
            listen=lambda *_: None,
        )


def test_a_folder_with_another_run_is_refused(first_iteration: Path, tmp_path: Path) -> None:
    shutil.copytree(first_iteration, tmp_path, dirs_exist_ok=True)
    with pytest.raises(CheckpointMismatch, match="that run has seed 0, not 1"):
        run(make_plan(tmp_path, seed=1), 1)
    longer = replace(RECIPES["ppo"], settings=replace(PAPER, decisions=13))
    with pytest.raises(CheckpointMismatch, match=r"settings\.decisions 12, not 13; .*recipe\.yaml"):
        run(make_plan(tmp_path, recipe=longer), 1)
    assert load_recipe(str(tmp_path / "recipe.yaml")) == RECIPES["ppo"]
    (tmp_path / "state.pt").write_bytes(b"what a broken disk leaves")
    with pytest.raises(CheckpointMismatch, match=r"state\.pt"):
        run(make_plan(tmp_path), 1)


SLIM = """
learner: ppo
network: {width: 16, feed_forward: 64}
settings: {episodes_per_iteration: 2, decisions: 16}
"""


def write_recipe(folder: Path, text: str) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "mine.yaml"
    path.write_text(text)
    return path


def spawn(
    start_program: StartProgram, out: Path, minutes: float, *options: str
) -> subprocess.Popen[bytes]:
    """Start training as a process of its own."""
    command = [sys.executable, "-m", "dronemon.training", "--device", "cpu"]
    command += ["--out", str(out), "--minutes", str(minutes), *options]
    return start_program(command, stdout=subprocess.DEVNULL)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_run_survives_kill_9(start_program: StartProgram, tmp_path: Path) -> None:
    options = ["--validation-episodes", "1", "--recipe", str(write_recipe(tmp_path, SLIM))]
    process = spawn(start_program, tmp_path, 1.0, *options)
    while not (tmp_path / "state.pt").exists():
        time.sleep(0.1)
        assert process.poll() is None
    time.sleep(2.3)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    before = read_tensors(tmp_path / "state.pt")["run"]
    spent_s = float((tmp_path / "spent_s").read_text())
    assert spawn(start_program, tmp_path, before["elapsed_s"] / 60.0 + 0.1, *options).wait() == 0
    after = read_tensors(tmp_path / "state.pt")["run"]
    assert after["iteration"] > before["iteration"]
    assert after["elapsed_s"] > max(spent_s, before["elapsed_s"])
    iterations = [row["iteration"] for row in logged(tmp_path)]
    assert iterations == [i + 1 for i in range(after["iteration"])]


def test_time_spent_in_an_iteration_that_was_killed_counts(
    first_iteration: Path, tmp_path: Path
) -> None:
    shutil.copytree(first_iteration, tmp_path, dirs_exist_ok=True)
    (tmp_path / "spent_s").write_text("5000.0\n")
    run(make_plan(tmp_path), 2)
    rows = logged(tmp_path)
    assert rows[0]["minutes"] < 60.0
    assert rows[1]["minutes"] > 5000.0 / 60.0


@pytest.mark.lengthy
def test_a_budget_of_iterations_does_not_ask_the_clock(
    first_iteration: Path, tmp_path: Path
) -> None:
    shutil.copytree(first_iteration, tmp_path, dirs_exist_ok=True)
    (tmp_path / "spent_s").write_text("5000.0\n")
    shares: list[float] = []
    plan = make_plan(tmp_path, minutes=0.1, iterations=3, validation_minutes=1e6)
    for _ in range(2):  # the second time nothing is left to do
        train(plan, ALONE, command="test", listen=lambda share, _: shares.append(share))
    assert shares == pytest.approx([2 / 3, 1.0])
    rows = logged(tmp_path)
    assert ["val_unc" in row for row in rows] == [True, False, True]
    assert rows[-1]["minutes"] > 5000.0 / 60.0


def test_two_budgets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="--minutes and --iterations"):
        train_command(out=tmp_path, minutes=1.0, iterations=1)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_minutes_of_training_improve_the_reward(
    start_program: StartProgram, tmp_path: Path
) -> None:
    network = "network: {width: 32, feed_forward: 128, ways: true}\n"
    for name, minutes, learner in (
        ("untrained", 0.1, "learner: ppo\nsettings: {episodes_per_iteration: 4, decisions: 96}\n"),
        ("trained", 2.0, "learner: expert\nsettings: {round_episodes: 4, decisions: 96}\n"),
    ):
        recipe = write_recipe(tmp_path / name, learner + network)
        options = ["--validation-episodes", "8", "--recipe", str(recipe)]
        assert spawn(start_program, tmp_path / name, minutes, *options).wait() == 0
    before, after = (
        load_checkpoint(tmp_path / name / "best.pt").card.scores
        for name in ("untrained", "trained")
    )
    assert after["val_reward"] > before["val_reward"]
    assert after["val_unc"] < before["val_unc"]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_two_processes_train_one_network_and_then_another(tmp_path: Path) -> None:
    recipe = write_recipe(tmp_path, SLIM.replace("iteration: 2", "iteration: 4"))
    (tmp_path / "second.yaml").write_text(recipe.read_text())
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node"]
    command += ["2", "-m", "dronemon.training", "--recipe", f"{recipe},{tmp_path}/second.yaml"]
    command += ["--device", "cpu", "--out", str(tmp_path / "out"), "--iterations", "2"]
    command += ["--validation-episodes", "1"]
    assert subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode == 0
    runs = [tmp_path / "out" / path.stem for path in (recipe, tmp_path / "second.yaml")]
    first, second = (logged(run) for run in runs)
    assert [row["decisions"] for row in first] == [64, 64]
    assert [row["unc"] for row in second] == [row["unc"] for row in first]
