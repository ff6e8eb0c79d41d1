import numpy as np

from dronemon.arena import ARENA
from dronemon.planner import paths, scoring
from dronemon.planner.moving import Walls


def test_refinement_changes_one_goal_and_keeps_the_others_in_order():
    rng = np.random.default_rng(10_000)
    forecast = scoring.Forecast(
        x=np.zeros((2, 3), dtype=np.float32),
        y=np.zeros((2, 3), dtype=np.float32),
        weight=np.ones(3, dtype=np.float32),
        probe_age=np.zeros((3, 4), dtype=np.int32),
        sight_age=np.zeros(3, dtype=np.int32),
        first=np.array([0, 3]),
        mean=np.zeros((1, 2, 2), dtype=np.float32),
        bounds=ARENA.bounds,
        together=np.empty(0, dtype=np.float32),
    )
    before = np.zeros((paths.MAX_GOALS, 2))
    before[:5] = (np.arange(5)[:, None] + [1.0, 1.5]) / 10.0
    lengths, walls = set(), Walls.of(ARENA, ARENA.field)
    for _ in range(500):
        goals = before.copy()
        count = paths.refine(goals, 5, forecast, walls, 0.05, rng)
        lengths.add(count)
        rows = {tuple(row) for row in before[:5]}
        kept = [row for row in map(tuple, goals[:count]) if row in rows]
        if count == 5 and len(kept) == 5:  # two goals swapped
            assert sorted(kept) == [tuple(row) for row in before[:5]]
        else:
            assert kept == sorted(kept)
            assert len(kept) >= min(count, 5) - 1
    assert lengths == {0, 1, 2, 3, 4, 5, 6}
