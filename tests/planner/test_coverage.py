"""Closed tracks that come near to every place of a field of any form."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from arenas import HOLED, U, drawn_arena
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.arena import ARENA, Arena
from dronemon.planner.lawnmower import LANE_SPACING_AU, Sweep, sweep_length_au, sweep_track
from dronemon.types import FloatArray

SQUARE = Arena.polygon(ARENA.outline_au[:-1])
"""As a polygon."""
NARROW = Arena.polygon(np.array([[0.0, 0.0], [3.0, 1.0], [3.0, 1.04], [0.0, 0.04]]))
TINY = Arena.polygon(np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.03]]))


def legs_of(track_au: FloatArray) -> FloatArray:
    """Of a closed track. (C, 2) -> (C, 2, 2)."""
    return np.stack([track_au, np.roll(track_au, -1, axis=0)], axis=1)


def far_off(arena: Arena, track_au: FloatArray, places_au: FloatArray) -> FloatArray:
    """How far places are from a track. (M, 2) -> (M,)."""
    lines = shapely.multilinestrings(shapely.linestrings(legs_of(track_au)))
    return shapely.distance(lines, shapely.points(places_au))


@settings(max_examples=25)
@given(arena=st.integers(10_000, 12_000).map(drawn_arena))
def test_legs_are_free_and_no_place_is_far_off(arena: Arena) -> None:
    track_au = sweep_track(arena)
    legs_au = legs_of(track_au)
    assert arena.free.is_free(legs_au[:, 0], legs_au[:, 1]).all()
    assert np.linalg.norm(legs_au[:, 1] - legs_au[:, 0], axis=-1).min() > 1e-6
    off = far_off(arena, track_au, arena.sample_free(400, np.random.default_rng(0)))
    assert off.max() <= 0.75 * LANE_SPACING_AU
    assert (off <= 0.55 * LANE_SPACING_AU).mean() > 0.85


@pytest.mark.parametrize("arena", [NARROW, TINY, U, HOLED])
def test_a_field_of_any_size_is_flown_round_and_round(arena: Arena) -> None:
    sweep, here_au = Sweep(arena), arena.sample_free(1, np.random.default_rng(0))[0]
    reached = []
    for _ in range(200):
        place_au = sweep.next_place(here_au)
        assert arena.segment_is_free(here_au, place_au)
        assert np.linalg.norm(place_au - here_au) > 1e-6
        here_au = place_au
        reached.append(np.linalg.norm(sweep.track_au - here_au, axis=-1).argmin())
    assert set(reached) == set(range(len(sweep.track_au)))


def test_the_square_as_a_polygon_is_swept_by_a_track_little_longer() -> None:
    """By that for which the way back has no lanes cut short."""
    lengths_au = [sweep_length_au(sweep_track(arena)) for arena in (SQUARE, ARENA)]
    assert lengths_au[0] <= 1.13 * lengths_au[1]


def test_long_fields_are_swept_along() -> None:
    corners_au = np.array([[0.0, 0.0], [4.0, 0.0], [4.2, 0.3], [4.0, 0.6], [0.0, 0.6]])
    track_au = sweep_track(Arena.polygon(corners_au))
    assert len(track_au) == 6
    assert np.ptp(track_au[:, 0]) > 3.8


def test_lanes_of_a_rectangle_lie_as_far_apart_as_those_of_the_square() -> None:
    for width, height in ((5.0, 3.0), (0.3, 2.0), (3.0, 0.1)):
        arena = Arena(low_au=(1.0, -1.0), high_au=(1.0 + width, height - 1.0))
        track_au = sweep_track(arena)
        assert arena.contains(track_au).all()
        lanes = np.unique(track_au[:, 1].round(9))
        assert len(lanes) == max(2, round(height / LANE_SPACING_AU))
        places = arena.sample(500, np.random.default_rng(0))
        assert far_off(arena, track_au, places).max() <= 0.75 * LANE_SPACING_AU
