"""Fields of any form: where one may be, the shortest ways, and what compiled code says of both."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
from arenas import U, drawn_arena
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.arena import CLEAR_AU, Arena
from dronemon.planner import moving

ARENAS = st.integers(0, 200).map(drawn_arena)


@settings(max_examples=40, deadline=None)
@given(arena=ARENAS)
def test_agent_and_targets_are_where_they_may_be(arena) -> None:
    rng = np.random.default_rng(0)
    field, zones = (
        shapely.Polygon(arena.border_au),
        shapely.union_all([shapely.Polygon(z) for z in arena.no_fly_au]),
    )
    targets, agents = arena.sample(300, rng), arena.sample_free(300, rng)
    assert shapely.dwithin(field, shapely.points(targets), 1e-9).all()
    for places in (agents, arena.clip_free(rng.uniform(-1.0, 2.0, (100, 2)))):
        points = shapely.points(places)
        assert shapely.dwithin(field, points, 1e-9).all()
        assert (shapely.distance(field.exterior, points) > arena.margin_au - 1e-9).all()
        assert (shapely.distance(zones, points) > arena.margin_au - 1e-9).all() or zones.is_empty


def test_draws_are_even() -> None:
    places = U.sample(20_000, np.random.default_rng(0))
    in_left = (places[:, 0] < 0.3) & (places[:, 1] > 0.3)
    assert in_left.mean() == pytest.approx(0.21 / 0.72, abs=0.01)
    assert (places[:, 1] < 0.15).mean() == pytest.approx(0.15 / 0.72, abs=0.01)


@settings(max_examples=60, deadline=None)
@given(arena=ARENAS, seed=st.integers(0, 1000))
def test_ways_are_free_and_none_is_shorter(arena, seed) -> None:
    start, end = arena.sample_free(2, np.random.default_rng(seed))
    way = np.concatenate([start[None], arena.way(start, end)])
    assert all(arena.segment_is_free(a, b) for a, b in pairwise(way))
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    assert length >= math.dist(start, end) - 1e-12
    back = np.concatenate([end[None], arena.way(end, start)])
    assert np.linalg.norm(np.diff(back, axis=0), axis=1).sum() == pytest.approx(length, abs=1e-9)
    for middle in arena.sample_free(20, np.random.default_rng(seed + 1)):
        legs = np.concatenate([start[None], arena.way(start, middle), arena.way(middle, end)])
        assert np.linalg.norm(np.diff(legs, axis=0), axis=1).sum() >= length - 8 * CLEAR_AU


def test_a_way_around_is_as_long_as_a_taut_string() -> None:
    way = np.concatenate([[[0.15, 0.9]], U.way(np.array([0.15, 0.9]), np.array([0.85, 0.9]))])
    assert len(way) == 4
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    assert length == pytest.approx(2.0 * math.hypot(0.15, 0.6) + 0.4, abs=4 * CLEAR_AU)


def test_a_way_from_a_corner_turned_at_goes_on() -> None:
    for corner in U.ways.corners_au:
        way = U.way(corner, np.array([0.15, 0.9]))
        assert math.dist(way[0], corner) > CLEAR_AU
        assert U.segment_is_free(corner, way[0])


def test_from_where_one_may_not_be_one_leaves_first() -> None:
    zone = np.array([[0.4, 0.4], [0.6, 0.4], [0.6, 0.6], [0.4, 0.6]])
    arena = Arena.polygon(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), [zone])
    way = arena.way(np.array([0.45, 0.5]), np.array([0.9, 0.5]))
    np.testing.assert_allclose(way[0], [0.4, 0.5])
    assert all(arena.segment_is_free(a, b) for a, b in pairwise(way))
    with pytest.raises(ValueError, match="no way"):
        arena.way(np.array([0.9, 0.5]), np.array([0.5, 0.5]))


def test_what_leaves_nothing_is_refused() -> None:
    border = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    with pytest.raises(ValueError, match="leave nothing"):
        Arena.polygon(border, [border * 1.2 - 0.1])
    with pytest.raises(ValueError, match="leave nothing"):
        Arena.polygon(border, margin_au=0.5)
    with pytest.raises(ValueError, match="crosses itself"):
        Arena.polygon(border[[0, 2, 1, 3]])


@pytest.mark.lengthy
@settings(max_examples=40, deadline=None)
@given(arena=ARENAS, seed=st.integers(0, 1000))
def test_compiled_code_says_the_same_of_places(arena, seed) -> None:
    places = np.random.default_rng(seed).uniform(-0.5, 1.5, (60, 2))
    for region in (arena.field, arena.free):
        walls = moving.Walls.of(arena, region)
        inside = [moving.is_inside(walls, *place) for place in places]
        np.testing.assert_array_equal(inside, region.contains(places))
        clipped = [moving.clipped(walls, *place) for place in places]
        np.testing.assert_allclose(clipped, region.clip(places), atol=1e-9)
        assert region.contains(moving.drawn(walls, np.random.default_rng(seed)))


@pytest.mark.lengthy
@settings(max_examples=60, deadline=None)
@given(arena=ARENAS, seed=st.integers(0, 1000))
def test_compiled_flight_goes_the_shortest_way(arena, seed) -> None:
    start, end = arena.clip_free(arena.sample_free(2, np.random.default_rng(seed)), CLEAR_AU)
    ground, path = moving.Ground.of(arena), np.zeros((200, 2))
    k, x, y, _, due, _ = moving.follow(*end, -1, ground, path, np.int64(0), *start, -1, 0.04)
    way = np.concatenate([start[None], arena.way(start, end)])
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    assert (x, y) == tuple(end)
    assert 0.04 + 0.1 * k - due == pytest.approx(length, abs=1e-6)
    assert arena.free.contains(path[:k]).all()
    at = [0.04 + 0.1 * i for i in range(k)]
    expected = shapely.get_coordinates(shapely.line_interpolate_point(shapely.LineString(way), at))
    np.testing.assert_allclose(path[:k], expected.reshape(-1, 2), atol=1e-6)


def test_most_drawn_ways_turn_somewhere() -> None:
    """Else the tests above would say little."""
    turns = [
        len(arena.way(*arena.sample_free(2, np.random.default_rng(seed)))) > 1
        for seed, arena in enumerate(map(drawn_arena, range(60)))
    ]
    assert np.mean(turns) > 0.2
