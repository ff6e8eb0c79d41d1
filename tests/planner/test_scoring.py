import numpy as np
import pytest
import torch

from dronemon.belief import fit
from dronemon.planner import scoring
from dronemon.planner.search import SearchSettings


def test_mean_fields_are_the_beliefs_means():
    rng = np.random.default_rng(10_000)
    counts = np.array([20, 0, 7])
    points = np.concatenate([rng.random((3, 20, 2)), 6.0 * rng.random((3, 20, 1))], axis=-1)
    values = (rng.random((3, 20)) < 0.3).astype(np.float64)
    size = scoring.MEAN_CELLS
    got = np.empty((3, size, size), dtype=np.float32)
    scoring.mean_fields(points, values, counts, 6.0, got)

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
        tables = scoring.make_tables(
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
        forecast = scoring.Forecast(
            x=np.full((1, 1), 0.6, dtype=np.float32),
            y=np.full((1, 1), 0.5, dtype=np.float32),
            weight=np.ones(1, dtype=np.float32),
            probe_age=np.full((1, 4), scoring.NUM_AGES - 1, dtype=np.int32),
            sight_age=np.zeros(1, dtype=np.int32),
            first=np.array([0, 1]),
            mean=np.full((1, scoring.MEAN_CELLS, scoring.MEAN_CELLS), 0.5, dtype=np.float32),
        )
        scratch = (
            forecast.probe_age.copy(),
            forecast.sight_age.copy(),
            np.empty(1, dtype=np.float32),
        )
        worth[shape_worth] = scoring.score(np.array([place]), forecast, tables, *scratch)
    assert (worth[5.0] > worth[0.0]) == gains
    assert worth[5.0] != worth[0.0]
