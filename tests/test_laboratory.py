"""What docs/laboratory.md shows works as it stands."""

from __future__ import annotations

import csv
import inspect
import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import fields
from importlib import import_module
from pathlib import Path

import gymnasium
import pytest

from dronemon import cli
from dronemon.belief import Scores
from dronemon.evaluation.results import Result
from dronemon.gym import Episodes
from dronemon.gym.monitoring import DECISIONS, NAME

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "laboratory.md").read_text()
COMMANDS = re.findall(r"(?m)^    dronemon (.*)$", PAGE)
(TRAINING,) = re.findall(r"(?m)^    OMP_NUM_THREADS=1 python ppo.py --minutes 10 --out (.*)$", PAGE)
PYTHON = re.compile(r"```python\n(.*?)```", re.DOTALL)
LOOP, TRAINED = PYTHON.findall(PAGE)
(PLANNER,) = PYTHON.findall((ROOT / "docs" / "your-own-planner.md").read_text())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where the page has been followed up to its commands, a policy trained but for a moment."""
    folder = tmp_path_factory.mktemp("laboratory")
    (folder / "my_planner.py").write_text(PLANNER)
    (folder / "trained.py").write_text(TRAINED)
    (folder / "ppo.py").write_text((ROOT / "examples" / "ppo.py").read_text())
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        import_module("ppo").train(0.001, Path(TRAINING), held_out=1)
        yield folder
    for name in ("my_planner", "trained", "ppo"):
        sys.modules.pop(name, None)


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_does_what_it_says(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = shlex.split(command)
    monkeypatch.setattr(sys, "argv", ["dronemon", *arguments])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert not caught.value.code
    given = {name: arguments[arguments.index(name) + 1] for name in ("--out", "--planner")}
    if arguments[0] == "evaluate":
        for name in ("table.md", "table.csv", "results.jsonl"):
            told = (folder / given["--out"] / name).read_text()
            assert all(planner in told for planner in given["--planner"].split(","))
        with (folder / given["--out"] / "paired.csv").open(newline="") as file:
            assert len(list(csv.DictReader(file))) > 0
    else:
        assert arguments[0] == "fly"
        assert (folder / given["--out"] / "decisions.jsonl").read_text()


def test_the_page_says_what_every_figure_is() -> None:
    told = set(re.findall(r"`(\w+)`", "".join(re.findall(r"(?m)^\| (`.*?) \| .* \|$", PAGE))))
    logged = {f.name for f in fields(Scores)} | {f.name for f in fields(Result)} | {"decision_ms"}
    named = {"method", "cell", "seed", "settings", "scores", "code"}  # what they are figures of
    assert logged - named <= told


def test_the_loop_runs(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(LOOP, "laboratory.md", "exec"), {})
    assert capsys.readouterr().out


def test_the_tables_say_what_is_observed_and_how_it_can_be_had() -> None:
    env = gymnasium.make(NAME, num_targets=5, num_nodes=7, num_neighbours=4)
    sizes = {"V": 8, "N": 5, "K": 7, "11": 11, "4": 4, "2": 2, "1": 1}
    told = re.findall(r"(?m)^\| `(\w+)` \| \(([^)]*)\) \| (\w+) \|", PAGE)
    assert {name for name, _, _ in told} == set(env.observation_space.spaces)
    for name, shape, dtype in told:
        space = env.observation_space[name]
        assert space.shape == tuple(sizes[s] for s in re.findall(r"\w+", shape)), name
        assert str(space.dtype) == dtype, name
    terms = dict(re.findall(r"(?m)^\| `(\w+)` \| `?(\w[\w.]*)`? \| [^|]*\|$", PAGE))
    parameters = inspect.signature(Episodes).parameters.values()
    expected = {p.name: p.default for p in parameters} | {"max_episode_steps": DECISIONS}
    assert terms == {name: str(value) for name, value in expected.items()}
