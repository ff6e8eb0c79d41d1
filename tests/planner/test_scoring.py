import numpy as np
import pytest

from dronemon.arena import ARENA
from dronemon.planner import scoring
from dronemon.planner.settings import SearchSettings


@pytest.mark.parametrize(("place", "gains"), [((0.47, 0.5), False), ((0.3, 0.5), True)])
def test_a_miss_gains_on_a_false_trail_and_costs_at_the_target(place, gains):
    # The target is believed at (0.6, 0.5); its presence is still remembered where `place` is false.
    worth = {}
    for shape_worth in (0.0, 5.0):
        settings = SearchSettings(num_steps=1, shape_worth=shape_worth)
        tables = scoring.make_tables(settings, speed=1 / 30)
        forecast = scoring.Forecast(
            x=np.full((1, 1), 0.6, dtype=np.float32),
            y=np.full((1, 1), 0.5, dtype=np.float32),
            weight=np.ones(1, dtype=np.float32),
            probe_age=np.full((1, 4), scoring.NUM_AGES - 1, dtype=np.int32),
            sight_age=np.zeros(1, dtype=np.int32),
            first=np.array([0, 1]),
            mean=np.full((1, scoring.MEAN_CELLS, scoring.MEAN_CELLS), 0.5, dtype=np.float32),
            bounds=ARENA.bounds,
        )
        scratch = (
            forecast.probe_age.copy(),
            forecast.sight_age.copy(),
            np.empty(1, dtype=np.float32),
        )
        worth[shape_worth] = scoring.score(np.array([place]), forecast, tables, *scratch)
    assert (worth[5.0] > worth[0.0]) == gains
    assert worth[5.0] != worth[0.0]
