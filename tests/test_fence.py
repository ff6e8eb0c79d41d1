"""The flight's fence: a convex polygon with few corners that keeps its margin."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.arena import Arena
from dronemon.fence import Fence, FenceArea
from dronemon.frames import AreaFrame, GeoPoint, ned_to_geo
from dronemon.types import Pose

ORIGIN = GeoPoint(latitude_deg=47.4, longitude_deg=8.5, altitude_m=488.0)
CORNERS_AU = np.array([[0, 0], [0, 1], [1, 1], [1, 0]], dtype=np.float64)


def _frame(side_m=100.0, heading_rad=0.0, centre_ned_m=(0.0, 0.0)) -> AreaFrame:
    return AreaFrame(
        centre_ned_m=centre_ned_m,
        ground_down_m=0.5,
        side_m=side_m,
        heading_rad=heading_rad,
        cruise_speed_m_s=5.0,
    )


def _fence(*others, margin_m=30.0, altitude_m=45.0, frame=None) -> Fence:
    frame = frame or _frame()
    others = others or (frame.centre_ned_m,)
    return Fence.around(frame, others, altitude_m=altitude_m, margin_m=margin_m)


@settings(max_examples=40)
@given(
    side_m=st.floats(10.0, 20_000.0),
    heading_rad=st.floats(-math.pi, math.pi),
    home=st.tuples(st.floats(-5000.0, 5000.0), st.floats(-5000.0, 5000.0)),
    margin_m=st.floats(10.0, 1000.0),
)
def test_area_home_and_the_way_between_keep_the_margin(side_m, heading_rad, home, margin_m):
    frame = _frame(side_m, heading_rad, (30.0, -40.0))
    fence = _fence(home, margin_m=margin_m, frame=frame)
    places_m = np.concatenate([frame.au_to_ned(CORNERS_AU), [home]])
    ways_m = [
        a + share * (b - a)
        for a, b in itertools.combinations(places_m, 2)
        for share in np.linspace(0.0, 1.0, 5)
    ]
    inside_m = fence.inside_m(np.array(ways_m))
    assert inside_m.min() >= margin_m * (1.0 - 1e-9) - 1e-6
    assert fence.inside_m(places_m).min() <= margin_m / math.cos(math.pi / 8) + 1e-6


@settings(max_examples=40)
@given(st.floats(-math.pi, math.pi), st.tuples(st.floats(-500, 500), st.floats(-500, 500)))
def test_it_is_convex_and_has_few_corners_in_order(heading_rad, home):
    fence = _fence(home, frame=_frame(heading_rad=heading_rad))
    corners_m = fence.corners_ned_m
    assert 8 <= len(corners_m) <= 13
    sides_m = np.roll(corners_m, -1, axis=0) - corners_m
    following_m = np.roll(sides_m, -1, axis=0)
    turns = sides_m[:, 0] * following_m[:, 1] - sides_m[:, 1] * following_m[:, 0]
    assert (turns > 0.0).all()
    assert np.abs(fence.inside_m(corners_m)).max() < 1e-6


def _pose(north_m=0.0, speed_m_s=0.0, down_m=-44.5) -> Pose:
    return Pose(
        time_s=1.0,
        position_ned_m=(north_m, 0.0, down_m),
        velocity_ned_m_s=(speed_m_s, 0.0, 0.0),
        attitude_rad=(0.0, 0.0, 0.0),
    )


@pytest.mark.parametrize(
    ("north_m", "speed_m_s", "stops"),
    [
        (79.0, 0.0, True),  # the fence is at 80 m
        (81.0, 0.0, False),
        (81.0, -5.0, True),
        (69.0, 5.0, True),
        (71.0, 5.0, False),
    ],
)
def test_it_looks_at_where_the_drone_can_stop(north_m, speed_m_s, stops):
    assert _fence().stops_inside(_pose(north_m, speed_m_s)) is stops


def test_heights_are_left_by_the_margin_or_half():
    heights = {height_m: _fence().is_at_height(_pose(down_m=0.5 - height_m), -44.5) for height_m in
               (22.0, 23.0, 45.0, 74.0, 76.0)}  # fmt: skip
    assert [height_m for height_m, is_right in heights.items() if is_right] == [23.0, 45.0, 74.0]


def _area(*corners_m, is_inclusion=True, radius_m=None) -> FenceArea:
    points = [ned_to_geo(np.array([*corner, 0.0]), ORIGIN) for corner in corners_m]
    corners = tuple((point.latitude_deg, point.longitude_deg) for point in points)
    return FenceArea(is_inclusion=is_inclusion, corners_deg=corners, radius_m=radius_m)


def _square(half_m, north_m=0.0, is_inclusion=True) -> FenceArea:
    ends = (north_m - half_m, north_m + half_m)
    corners = [(ends[0], -half_m), (ends[0], half_m), (ends[1], half_m), (ends[1], -half_m)]
    return _area(*corners, is_inclusion=is_inclusion)


NOTCH = ((-200.0, -200.0), (-200.0, 200.0), (200.0, 200.0), (200.0, 1.0), (-150.0, 0.0),
         (200.0, -1.0), (200.0, -200.0))  # fmt: skip


@pytest.mark.parametrize(
    ("area", "allows"),
    [
        (_square(100.0), True),
        (_square(75.0), False),
        (_square(20.0), False),
        (_square(100.0, north_m=300.0), False),
        (_area(*NOTCH), False),  # all corners are inside, and a way is not
        (_area((0.0, 0.0), radius_m=130.0), True),
        (_area((0.0, 0.0), radius_m=100.0), False),
        (_square(20.0, is_inclusion=False), False),
        (_square(500.0, is_inclusion=False), False),
        (_square(60.0, north_m=120.0, is_inclusion=False), False),
        (_square(60.0, north_m=150.0, is_inclusion=False), True),
        (_area((110.0, 0.0), radius_m=29.0, is_inclusion=False), True),
        (_area((110.0, 0.0), radius_m=31.0, is_inclusion=False), False),
    ],
)
def test_the_vehicles_own_areas_allow_it_or_not(area, allows):
    assert area.allows(_fence(), ORIGIN) is allows


def test_a_fence_can_be_that_which_was_laid_before():
    now, before = _fence((20.0, 30.0)), _fence((0.0, 200.0), margin_m=40.0)
    laid = now.laid_as(before.corners_ned_m)
    assert laid.corners_deg(ORIGIN) == before.corners_deg(ORIGIN)
    assert laid.heights_m == now.heights_m
    places_m = np.random.default_rng(0).uniform(-300.0, 300.0, (50, 2))
    np.testing.assert_allclose(laid.inside_m(places_m), before.inside_m(places_m), atol=1e-6)


def test_a_field_of_many_corners_has_a_fence_of_few_around_it() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False)
    border_au = 0.5 + np.stack([0.8 * np.cos(angle), 0.5 * np.sin(angle)], axis=-1)
    zone_au = 0.5 + 0.1 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    frame = replace(_frame(), arena=Arena.polygon(border_au, [zone_au]))
    fence = Fence.around(frame, [(0.0, 0.0)], altitude_m=30.0, margin_m=20.0)
    assert len(fence.corners_ned_m) <= 16
    inside_m = fence.inside_m(frame.au_to_ned(border_au))
    assert inside_m.min() >= 20.0 - 1e-6
    assert inside_m.min() < 30.0
    assert not fence.stops_inside(_pose(9.0))  # the zone is 20 m about the centre
    assert fence.stops_inside(_pose(11.0))
