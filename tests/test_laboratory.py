"""What docs/laboratory.md shows works as it stands."""

from __future__ import annotations

import csv
import inspect
import re
import shlex
import sys
from pathlib import Path

import gymnasium
import pytest

from dronemon import cli
from dronemon.gym import Episodes
from dronemon.gym.monitoring import DECISIONS, NAME

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "laboratory.md").read_text()
COMMANDS = re.findall(r"(?m)^    dronemon (.*)$", PAGE)
PYTHON = re.compile(r"```python\n(.*?)```", re.DOTALL)


@pytest.mark.slow
def test_the_planner_is_evaluated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (command,) = COMMANDS
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (planner,) = PYTHON.findall((DOCS / "your-own-planner.md").read_text())
    (tmp_path / "my_planner.py").write_text(planner)
    monkeypatch.setattr(sys, "argv", ["dronemon", *shlex.split(command)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    sys.modules.pop("my_planner", None)
    assert not caught.value.code
    folder = tmp_path / "runs" / "mine"
    for name in ("table.md", "table.csv", "results.jsonl"):
        assert "my_planner:Curious" in (folder / name).read_text()
    with (folder / "paired.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) > 0


@pytest.mark.parametrize("code", PYTHON.findall(PAGE))
def test_the_code_runs(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(code, "laboratory.md", "exec"), {})
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
