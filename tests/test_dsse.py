"""Our search flies DSSE's task: the moves are right, and its particles go with the matrix."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

FILE = Path(__file__).parents[1] / "benchmarks" / "dsse.py"


@pytest.fixture(scope="module")
def dsse() -> ModuleType:
    spec = importlib.util.spec_from_file_location("dsse_benchmark", FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def bell(x: float, y: float, width: float) -> np.ndarray:
    rows, columns = np.indices((40, 40))
    chance = np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / width**2)
    return chance / chance.sum()


def test_particles_drift_and_spread_as_the_matrix_did(dsse: ModuleType) -> None:
    cloud = dsse.Cloud(np.random.default_rng(0))
    for step in range(11):
        cloud.learn(bell(10.0 + 0.2 * step, 20.0 + 0.1 * step, 2.0 + 0.1 * step))
    np.testing.assert_allclose(cloud.change, [0.2, 0.1, 0.1], atol=0.01)
    now, later = cloud.places(), cloud.places(10.0)
    np.testing.assert_allclose(now.mean(axis=0), [12.0, 21.0], atol=0.2)
    np.testing.assert_allclose(later.mean(axis=0), [14.0, 22.0], atol=0.3)
    np.testing.assert_allclose(later.std(axis=0), [4.0, 4.0], atol=0.2)


def test_a_search_in_vain_leaves_no_chance_there_and_all_of_it_elsewhere(dsse: ModuleType) -> None:
    cloud = dsse.Cloud(np.random.default_rng(0))
    cloud.learn(bell(10.0, 20.0, 2.0))
    assert cloud.chances()[20, 10] > 0.02
    cloud.miss((10, 20))
    assert cloud.chances()[20, 10] == 0.0
    assert cloud.chances().sum() == pytest.approx(1.0)


def test_a_move_brings_every_cell_nearer(dsse: ModuleType) -> None:
    steps = {action: step for step, action in dsse.MOVES.items()}
    for goal in np.ndindex(5, 5):
        action = dsse.towards((2, 2), goal)
        assert (action == dsse.SEARCH) == (goal == (2, 2))
        if action != dsse.SEARCH:
            moved = np.add((2, 2), steps[action])
            assert np.abs(goal - moved).max() == np.abs(np.subtract(goal, (2, 2))).max() - 1


@pytest.mark.parametrize("column", [8, 32])
def test_our_search_goes_where_the_matrix_has_the_person(dsse: ModuleType, column: int) -> None:
    steps = {action: step for step, action in dsse.MOVES.items()}
    policy, here, num_searches = dsse.Search(np.random.default_rng(0)), (20, 0), 0
    for _ in range(40):
        action = policy.act(here, bell(column, 20.0, 2.0))
        num_searches += action == dsse.SEARCH
        here = tuple(int(x) for x in np.add(here, steps.get(action, (0, 0))))
        assert action != dsse.SEARCH or np.abs(np.subtract(here, (column, 20))).max() <= 6
    assert num_searches >= 5


@pytest.mark.slow
def test_every_policy_flies_the_public_task(
    dsse: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    pytest.importorskip("DSSE")
    for make in dsse.POLICIES.values():
        first, again = (dsse.fly(make(np.random.default_rng(0)), 10_000) for _ in range(2))
        assert first == again
        assert first[1] <= dsse.LIMIT_STEPS + 1
