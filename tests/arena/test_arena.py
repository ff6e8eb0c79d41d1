"""Where one may be: what the arena says of places, and what its compiled twin says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dronemon.arena import ARENA, ROUNDING_AU, Arena
from dronemon.planner import moving

FIELD = Arena(low_au=(-0.5, 1.0), high_au=(1.5, 1.75))
ARENAS = st.sampled_from([ARENA, FIELD])
PLACES = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)).map(np.array)


def inside_by_au(arena: Arena, place_au) -> float:
    """How far inside a place is; negative outside."""
    outside_au = np.maximum(arena.low_au - place_au, place_au - arena.high_au)
    is_outside = outside_au.max() > 0.0
    return float(-np.hypot(*outside_au.clip(0.0)) if is_outside else -outside_au.max())


@settings(max_examples=100)
@given(arena=ARENAS, place=PLACES)
def test_the_nearest_place_is_inside_and_as_far_as_the_border(arena, place) -> None:
    clipped = arena.clip(place)
    assert arena.contains(clipped)
    np.testing.assert_array_equal(arena.clip(clipped), clipped)
    distance_au = inside_by_au(arena, place)
    assume(not -1.5 < distance_au / ROUNDING_AU < -0.5)  # may count as either, more so at corners
    assert arena.contains(place) == (distance_au >= -ROUNDING_AU)
    assert np.linalg.norm(clipped - place) == pytest.approx(max(-distance_au, 0.0))
    assert arena.segment_is_free(clipped, place) == arena.contains(place)
    inner = arena.clip_free(place, 0.1)
    assert inside_by_au(arena, inner) >= 0.1 - 1e-12


@pytest.mark.lengthy
@settings(max_examples=100)
@given(arena=ARENAS, place=PLACES)
def test_compiled_code_says_the_same(arena, place) -> None:
    walls = moving.Walls.of(arena, arena.field)
    assert moving.is_inside(walls, *place) == (inside_by_au(arena, place) >= 0.0)
    clipped = arena.clip(place)
    np.testing.assert_array_equal(moving.clipped(walls, *place), clipped)
    column, row = moving.cell(arena.bounds, *clipped, 8, 5)
    centre = arena.cells(8, 5).reshape(8, 5, 2)[column, row]
    assert np.all(np.abs(centre - clipped) <= arena.extent_au / [16.0, 10.0] + 1e-12)


@pytest.mark.parametrize("arena", [ARENA, FIELD])
def test_samples_and_grids_fill_it(arena) -> None:
    places = arena.sample(2000, np.random.default_rng(0))
    assert arena.contains(places).all()
    walls = moving.Walls.of(arena, arena.field)
    drawn = np.array([moving.drawn(walls, np.random.default_rng(0)) for _ in range(2)])
    np.testing.assert_allclose(drawn, places[[0, 0]], rtol=1e-15)
    np.testing.assert_allclose(places.min(axis=0), arena.low_au, atol=0.01)
    np.testing.assert_allclose(places.max(axis=0), arena.high_au, atol=0.01)
    grid = arena.grid(5)
    np.testing.assert_array_equal(grid[[0, -1]], arena.bounds)
    np.testing.assert_array_equal(grid[1], [arena.low_au[0], arena.axes(5)[1, 1]])


def test_what_is_no_place_is_not_inside() -> None:
    assert not ARENA.contains(np.array([[np.nan, 0.5], [0.5, np.inf]])).any()
    assert np.isnan(ARENA.clip(np.array([np.nan, 0.5]))[0])
