"""Small moves that planners share, in fields of any form."""

from __future__ import annotations

import numpy as np
import pytest
from arenas import HOLED, U, drawn_arena

from dronemon.arena import ARENA, Arena
from dronemon.planner.motion import ORBIT_RADIUS_AU, orbit, way_length_au

NARROW = Arena.polygon(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.01], [0.0, 0.01]]))


@pytest.mark.parametrize(
    "arena", [ARENA, U, HOLED, NARROW, *map(drawn_arena, range(10_000, 10_005))]
)
def test_an_orbit_stays_near_its_place_and_never_stands_still(arena: Arena) -> None:
    for centre_au in arena.sample_free(10, np.random.default_rng(0)):
        here_au = centre_au
        for _ in range(8):
            place_au = orbit(here_au, centre_au, arena)
            assert arena.clip_free(place_au) == pytest.approx(place_au, abs=1e-9)
            assert np.linalg.norm(place_au - here_au) > 0.3 * ORBIT_RADIUS_AU
            assert np.linalg.norm(place_au - centre_au) <= 3.0 * ORBIT_RADIUS_AU + 1e-9
            here_au = place_au


def test_a_way_is_as_long_as_its_legs() -> None:
    here_au, end_au = np.array([0.15, 0.9]), np.array([0.85, 0.9])
    assert way_length_au(here_au, end_au[None]) == pytest.approx(0.7)
    length_au = way_length_au(here_au, U.way(here_au, end_au))
    assert length_au == pytest.approx(U.distances(here_au[None], end_au[None])[0, 0])
