"""Ways around discs: into none that they do not begin in, out of these first, and in the arena."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dronemon.arena import ARENA, Arena, detour, into
from dronemon.types import FloatArray

FIELD = Arena.polygon(
    np.array([[0.0, 0.0], [1.2, 0.0], [1.2, 0.5], [0.7, 0.5], [0.7, 1.0], [0.0, 1.0]]),
    [np.array([[0.3, 0.3], [0.5, 0.3], [0.4, 0.6]])],
    margin_au=0.03,
)
TOLERANCE_AU = 1e-6
share = st.integers(0, 1000).map(lambda part: part / 1000)
places = st.tuples(share, share).map(np.array)
discs = st.lists(st.tuples(share, share, st.floats(0.02, 0.2)), max_size=6).map(
    lambda rows: np.array(rows).reshape(-1, 3)
)
arenas = st.sampled_from([ARENA, FIELD])


def nearest_of(arena: Arena, place_au: FloatArray) -> FloatArray:
    low, high = arena.bounds
    return arena.clip_free(low + place_au * (high - low))


def least_au(path_au: FloatArray, centre_au: FloatArray) -> float:
    """By many places on the path, and not as the code does it."""
    shares = np.linspace(0.0, 1.0, 200)[:, None, None]
    on = (1.0 - shares) * path_au[:-1] + shares * path_au[1:]
    away_au = np.linalg.norm(np.concatenate([path_au, *on]) - centre_au, axis=-1)
    return float(away_au.min())


@given(arenas, places, places, discs)
def test_a_way_goes_into_no_disc_that_it_does_not_begin_in(arena, start, goal, discs_au):
    start_au, goal_au = nearest_of(arena, start), nearest_of(arena, goal)
    way_au = detour(arena, start_au, goal_au, discs_au)
    path_au = np.concatenate([start_au[None], way_au])
    for *centre_au, radius_au in discs_au:
        around_au = radius_au / math.cos(math.pi / 12.0)  # its polygon's corners
        if math.dist(start_au, centre_au) >= around_au:
            assert least_au(path_au, centre_au) > radius_au - TOLERANCE_AU
        elif len(way_au):
            assert least_au(path_au[1:], centre_au) > radius_au - TOLERANCE_AU, "it comes out"


@given(arenas, places, places, discs)
def test_it_stays_in_the_arena(arena, start, goal, discs_au):
    start_au, goal_au = nearest_of(arena, start), nearest_of(arena, goal)
    path_au = np.concatenate([start_au[None], detour(arena, start_au, goal_au, discs_au)])
    for a_au, b_au in pairwise(path_au):
        assert arena.segment_is_free(a_au, b_au)


@given(arenas, places, places, discs)
def test_it_ends_at_a_goal_that_it_may_reach_else_at_the_edge_of_what_keeps_it(
    arena, start, goal, discs_au
):
    start_au, goal_au = nearest_of(arena, start), nearest_of(arena, goal)
    way_au = detour(arena, start_au, goal_au, discs_au)
    straight_au = np.stack([start_au, goal_au])
    if arena.segment_is_free(start_au, goal_au) and not into(straight_au, discs_au).any():
        assert way_au == pytest.approx(goal_au[None])
    elif len(way_au) and math.dist(way_au[-1], goal_au) > TOLERANCE_AU:
        on_au = np.stack([way_au[-1], way_au[-1] + 1e-3 * (goal_au - way_au[-1])])
        assert not arena.segment_is_free(*on_au) or _touches(on_au, discs_au)


def _touches(path_au: FloatArray, discs_au: FloatArray) -> bool:
    """Whether a way leads into the polygon of a disc."""
    wider_au = discs_au * [1.0, 1.0, 1.0 / math.cos(math.pi / 12.0)]
    return bool(into(path_au, wider_au).any())


@given(places, st.floats(0.02, 0.2), places)
def test_the_way_out_of_a_disc_is_the_nearest(centre, radius_au, goal):
    centre_au = 0.3 + 0.4 * centre
    start_au = centre_au + radius_au * np.array([0.6, 0.0])
    way_au = detour(ARENA, start_au, goal, np.array([[*centre_au, radius_au]]))
    assert 0.39 * radius_au < math.dist(start_au, way_au[0]) < 0.45 * radius_au


def test_it_comes_out_of_one_disc_without_going_into_another():
    discs_au = np.array([[0.5, 0.5, 0.1], [0.61, 0.5, 0.025]])
    start_au = np.array([0.58, 0.5])
    way_au = detour(ARENA, start_au, np.array([0.9, 0.5]), discs_au)
    assert least_au(np.concatenate([start_au[None], way_au]), discs_au[1, :2]) > 0.025
    assert math.dist(start_au, way_au[0]) < 0.06


def test_it_goes_the_shorter_way_around():
    disc = np.array([[0.5, 0.55, 0.1]])
    way_au = detour(ARENA, np.array([0.2, 0.5]), np.array([0.8, 0.5]), disc)
    assert way_au[:-1, 1].max() < 0.5
    length_au = np.linalg.norm(np.diff([[0.2, 0.5], *way_au], axis=0), axis=1).sum()
    assert 0.6 < length_au < 0.62


def test_who_is_shut_in_goes_as_near_as_discs_allow():
    ring = [(0.5 + 0.2 * math.cos(a), 0.5 + 0.2 * math.sin(a), 0.12) for a in range(7)]
    start_au, goal_au = np.array([0.48, 0.5]), np.array([0.9, 0.5])
    way_au = detour(ARENA, start_au, goal_au, np.array(ring))
    assert 0.0 < math.dist(way_au[-1], start_au) < 0.15


def test_where_discs_cover_all_there_is_no_way():
    disc = np.array([[0.5, 0.5, 2.0]])
    assert detour(ARENA, np.array([0.5, 0.5]), np.array([0.9, 0.5]), disc).shape == (0, 2)


def test_without_discs_it_is_the_arenas_way():
    start_au, goal_au = np.array([0.35, 0.2]), np.array([0.45, 0.8])
    way_au = detour(FIELD, start_au, goal_au, np.empty((0, 3)))
    assert way_au.tolist() == FIELD.way(start_au, goal_au).tolist()
