import numpy as np
import pytest
import torch

from dronemon.belief import fit
from dronemon.planner import paths
from dronemon.planner.search import SearchSettings


def test_mean_fields_are_the_beliefs_means():
    rng = np.random.default_rng(10_000)
    counts = np.array([20, 0, 7])
    points = np.concatenate([rng.random((3, 20, 2)), 6.0 * rng.random((3, 20, 1))], axis=-1)
    values = (rng.random((3, 20)) < 0.3).astype(np.float64)
    size = paths.MEAN_CELLS
    got = np.empty((3, size, size), dtype=np.float32)
    paths.mean_fields(points, values, counts, 6.0, got)

    centres = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    grid = torch.stack(torch.meshgrid(centres, centres, indexing="ij"), dim=-1).reshape(-1, 2)
    query = torch.cat([grid, torch.full((size**2, 1), 6.0, dtype=torch.float64)], dim=-1)
    mask = torch.arange(20) < torch.as_tensor(counts)[:, None]
    belief = fit(torch.as_tensor(points), torch.as_tensor(values), mask)
    expected = belief.mean(query).reshape(3, size, size).numpy()
    assert np.abs(got - expected).max() < 0.01  # the table is that coarse at the kernel's peak
    assert not got[1].any()


@pytest.mark.parametrize(("place", "gains"), [((0.47, 0.5), False), ((0.3, 0.5), True)])
def test_a_miss_gains_on_a_false_trail_and_costs_at_the_target(place, gains):
    # The target is believed at (0.6, 0.5); its presence is still remembered where `place` is false.
    settings = SearchSettings()
    worth = {}
    for shape_worth in (0.0, 5.0):
        tables = paths.make_tables(
            speed=1 / 30,
            num_steps=1,
            discount=settings.discount,
            fading=settings.fading,
            drift=settings.drift,
            probe_au=settings.probe_au,
            sight_gain=settings.sight_gain,
            forget_steps=settings.forget_steps,
            shape_worth=shape_worth,
        )
        scene = paths.Scene(
            x=np.full((1, 1), 0.6, dtype=np.float32),
            y=np.full((1, 1), 0.5, dtype=np.float32),
            weight=np.ones(1, dtype=np.float32),
            probe_age=np.full((1, 4), paths.NUM_AGES - 1, dtype=np.int32),
            sight_age=np.zeros(1, dtype=np.int32),
            first=np.array([0, 1]),
            mean=np.full((1, paths.MEAN_CELLS, paths.MEAN_CELLS), 0.5, dtype=np.float32),
        )
        scratch = scene.probe_age.copy(), scene.sight_age.copy(), np.empty(1, dtype=np.float32)
        worth[shape_worth] = paths.score(np.array([place]), scene, tables, *scratch)
    assert (worth[5.0] > worth[0.0]) == gains
    assert worth[5.0] != worth[0.0]


def test_a_step_over_the_border_goes_along_it_as_far():
    rng = np.random.default_rng(10_000)
    bearings = 2.0 * np.pi * rng.random(2000)
    places = np.concatenate([rng.random((1000, 2)), rng.choice([0.0, 0.02, 0.98, 1.0], (1000, 2))])
    for (x, y), bearing in zip(places, bearings, strict=True):
        to = np.array(paths.advance(x, y, 0.1 * np.cos(bearing), 0.1 * np.sin(bearing)))
        assert np.all((to >= 0.0) & (to <= 1.0))
        assert np.hypot(*(to - (x, y))) == pytest.approx(0.1)


def test_refinement_changes_one_goal_and_keeps_the_others_in_order():
    rng = np.random.default_rng(10_000)
    scene = paths.Scene(
        x=np.zeros((2, 3), dtype=np.float32),
        y=np.zeros((2, 3), dtype=np.float32),
        weight=np.ones(3, dtype=np.float32),
        probe_age=np.zeros((3, 4), dtype=np.int32),
        sight_age=np.zeros(3, dtype=np.int32),
        first=np.array([0, 3]),
        mean=np.zeros((1, 2, 2), dtype=np.float32),
    )
    before = np.zeros((paths.MAX_GOALS, 2))
    before[:5] = (np.arange(5)[:, None] + [1.0, 1.5]) / 10.0
    lengths = set()
    for _ in range(500):
        goals = before.copy()
        count = paths.refine(goals, 5, scene, 0.05, rng)
        lengths.add(count)
        rows = {tuple(row) for row in before[:5]}
        kept = [row for row in map(tuple, goals[:count]) if row in rows]
        if count == 5 and len(kept) == 5:  # two goals swapped
            assert sorted(kept) == [tuple(row) for row in before[:5]]
        else:
            assert kept == sorted(kept)
            assert len(kept) >= min(count, 5) - 1
    assert lengths == {0, 1, 2, 3, 4, 5, 6}
