import numpy as np
import pytest

from dronemon.arena import ARENA, Arena
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
            mean=np.full((1, *scoring.mean_cells(ARENA)), 0.5, dtype=np.float32),
            bounds=ARENA.bounds,
            together=np.empty(0, dtype=np.float32),
        )
        scratch = (
            forecast.probe_age.copy(),
            forecast.sight_age.copy(),
            np.empty(1, dtype=np.float32),
        )
        worth[shape_worth] = scoring.score(np.array([place]), forecast, tables, *scratch)
    assert (worth[5.0] > worth[0.0]) == gains
    assert worth[5.0] != worth[0.0]


@pytest.mark.parametrize("together", [None, 0.0, 0.5, 1.0])
def test_where_a_path_ends_counts_by_who_is_beyond_it_as_far_as_that_one_can_be_found(together):
    """One target, 3.05 au ahead of one path's end and 3.25 au from the other's."""
    tables = scoring.make_tables(SearchSettings(num_steps=2), speed=1 / 30)
    forecast = scoring.Forecast(
        x=np.full((2, 1), 4.25, dtype=np.float32),
        y=np.full((2, 1), 1.0, dtype=np.float32),
        weight=np.ones(1, dtype=np.float32),
        probe_age=np.full((1, 4), scoring.NUM_AGES - 1, dtype=np.int32),
        sight_age=np.full(1, 20, dtype=np.int32),
        first=np.array([0, 1]),
        mean=np.zeros((1, 8, 8), dtype=np.float32),
        bounds=Arena(high_au=(8.0, 8.0)).bounds,
        together=np.array([] if together is None else [together], dtype=np.float32),
    )
    gains = []
    for end_x in (1.2, 1.0):
        scratch = forecast.probe_age.copy(), forecast.sight_age.copy(), np.empty(1, np.float32)
        path_au = np.array([[1.1, 1.0], [end_x, 1.0]])
        gains.append(scoring.score(path_au, forecast, tables, *scratch))
    ahead, back = gains
    certain = tables.worth[tables.seen_age] - tables.worth[scoring.NUM_AGES - 1]
    found = tables.known[20 + 32] + 4.0 * certain  # 2 measurements ahead and 30 beyond
    expected = (together or 0.0) * SearchSettings().discount ** 32.5 * found
    assert ahead == pytest.approx(expected, rel=1e-5)
    assert (ahead > back) == bool(together)
