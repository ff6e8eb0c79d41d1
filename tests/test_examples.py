"""The example learns: a few updates run as they should, and a minute of them helps."""

from __future__ import annotations

import csv
import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from dronemon.problem import FIRST_DEVELOPMENT_SEED, FIRST_TRAINING_SEED

PPO = Path(__file__).parents[1] / "examples" / "ppo.py"


@pytest.fixture
def ppo() -> ModuleType:
    """The example as a module of its own."""
    spec = importlib.util.spec_from_file_location("example_ppo", PPO)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_few_updates_are_logged_by_numbers_that_are_defined(
    ppo: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ppo, "PROBLEM", ppo.PROBLEM | {"num_nodes": 15, "max_episode_steps": 6})
    monkeypatch.setattr(ppo, "EPISODES", 4)
    torch.manual_seed(0)
    untrained = ppo.Policy().state_dict()
    before, after = ppo.train(0.02, tmp_path, held_out=2)
    with (tmp_path / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == list(ppo.METRICS)
    assert [int(row["decisions"]) for row in rows] == [24 * (i + 1) for i in range(len(rows))]
    assert all(np.isfinite(float(x)) for row in rows for x in row.values())
    board = EventAccumulator(str(tmp_path)).Reload()
    for name in set(ppo.METRICS) - {"decisions", "minutes"}:
        drawn = [(event.step, event.value) for event in board.Scalars(name)]
        logged = [(int(row["decisions"]), float(row[name])) for row in rows]
        np.testing.assert_allclose(drawn, logged, rtol=1e-5)
    trained = torch.load(tmp_path / "policy.pt", weights_only=True)
    assert any((trained[name] != untrained[name]).any() for name in untrained)
    assert before["reward"].shape == after["reward"].shape == (6, 2)


def test_it_is_short_and_judged_on_seeds_that_it_never_sees(ppo: ModuleType) -> None:
    assert len(PPO.read_text().splitlines()) < 150
    assert ppo.HELD_OUT_SEED == FIRST_DEVELOPMENT_SEED
    assert ppo.FIRST_SEED == FIRST_TRAINING_SEED


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_minute_of_training_is_better_than_none(ppo: ModuleType, tmp_path: Path) -> None:
    before, after = ppo.train(1.5, tmp_path, seed=1)
    for name, sign in (("return", 1.0), ("unc", -1.0)):
        gain = sign * (after[name] - before[name])  # of the same instances
        assert gain.mean() > 5.0 * gain.std() / len(gain) ** 0.5, name
