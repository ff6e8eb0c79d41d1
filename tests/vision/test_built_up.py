"""What stands on the ground hides what is behind it: against rays cast step by step."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.frames import AreaFrame, ground_to_pixel
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.sightings import Sightings, is_in_view
from dronemon.types import CameraModel, Detection, Obstacle, Pose
from dronemon.vision.built_up import BuiltUp
from dronemon.vision.observe import observe
from dronemon.vision.owners import Owners
from dronemon.vision.surface import Plane

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
FRAME = AreaFrame(
    centre_ned_m=(40.0, -25.0),
    ground_down_m=1.5,
    side_m=300.0,
    heading_rad=0.5,
    cruise_speed_m_s=5.0,
)
HEIGHT_M = 66.0
EYE_AU = np.array([0.4, 0.7])
NUM_STEPS = 150
FLAT = Plane(FRAME.ground_down_m)


class Hills(Plane):
    """Ground that goes up and down by 9 m."""

    def down_m(self, place_ned_m):
        north, east = np.moveaxis(np.asarray(place_ned_m), -1, 0)
        return self._down_m + 9.0 * np.sin(north / 17.0) * np.cos(east / 23.0)


HILLS = Hills(FRAME.ground_down_m)


def pose_over(at_au=EYE_AU, height_m=HEIGHT_M, attitude=(0.0, 0.0, 0.3)) -> Pose:
    return replace(
        Pose.level(height_m - FRAME.ground_down_m),
        position_ned_m=(*FRAME.au_to_ned(at_au), FRAME.ground_down_m - height_m),
        attitude_rad=attitude,
    )


def beside(*away_au):
    """A place so far east and north of the camera, or several."""
    return EYE_AU + np.array(away_au)


def block(*corners_au, height_m=30.0) -> Obstacle:
    return Obstacle(corners_au=np.array(corners_au), height_m=height_m)


def box(low, high, height_m=30.0) -> Obstacle:
    (left, bottom), (right, top) = low, high
    return block((left, bottom), (right, bottom), (right, top), (left, top), height_m=height_m)


@st.composite
def blocks(draw) -> Obstacle:
    """Anything star-shaped, near the camera, beside it or around it."""
    num_corners = draw(st.integers(3, 9))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    centre_au = EYE_AU + rng.uniform(-0.12, 0.12, 2)
    steps = rng.uniform(0.2, 1.0, num_corners)
    bearings = rng.uniform(0.0, math.tau) + math.tau * np.cumsum(steps) / steps.sum()
    radii_au = rng.uniform(0.005, 0.06, num_corners)
    around = np.stack([np.cos(bearings), np.sin(bearings)], axis=-1) * radii_au[:, None]
    return Obstacle(
        corners_au=centre_au + around, height_m=draw(st.sampled_from([2.0, 30.0, 80.0]))
    )


def cast(obstacle: Obstacle, ground, pose: Pose, places_au):
    """Whether a ray is in an obstacle at any of many steps down to the ground. -> (P,)"""
    shape = shapely.Polygon(obstacle.corners_au)
    low, high = obstacle.corners_au.min(axis=0), obstacle.corners_au.max(axis=0)
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 41, axis=1)), axis=-1).reshape(-1, 2)
    inside = grid[shapely.intersects_xy(shape, *grid.T)]
    under_au = np.concatenate([inside, obstacle.corners_au])
    top_down_m = ground.down_m(FRAME.au_to_ned(under_au)).min() - obstacle.height_m
    share = np.linspace(0.0, 1.0, NUM_STEPS)[:, None]
    eye_au, eye_down_m = FRAME.ned_to_au(np.array(pose.position_ned_m)), pose.position_ned_m[2]
    down_m = ground.down_m(FRAME.au_to_ned(places_au))
    at_au = eye_au + share[..., None] * (places_au - eye_au)
    is_low = eye_down_m + share * (down_m - eye_down_m) >= top_down_m
    return np.any(is_low & shapely.intersects_xy(shape, at_au[..., 0], at_au[..., 1]), axis=0)


def places_about(count=600):
    """Places all over the sensor's circle. -> (P, 2)"""
    rng = np.random.default_rng(0)
    bearing, away_au = math.tau * rng.random(count), SENSOR_RADIUS_AU * np.sqrt(rng.random(count))
    return EYE_AU + away_au[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)


def look(surface, pose, detections=(), appearances=("cow",)):
    measurement, _ = observe(
        detections,
        pose=pose,
        camera=CAMERA,
        frame=FRAME,
        surface=surface,
        owners=Owners(appearances),
        sightings=Sightings(np.full((len(appearances), 2), np.nan)),
        time_au=1.0,
    )
    return measurement


@pytest.mark.parametrize("ground", [FLAT, HILLS])
@settings(max_examples=18, deadline=None)
@given(obstacles=st.lists(blocks(), min_size=1, max_size=3))
def test_hidden_ground_is_never_called_seen(ground, obstacles):
    pose, places_au = pose_over(), places_about()
    seen = look(BuiltUp(ground, FRAME, obstacles), pose)
    is_hidden = np.any([cast(o, ground, pose, places_au) for o in obstacles], axis=0)
    assert not np.any(is_in_view(seen, places_au) & is_hidden)
    assert seen.view_au <= seen.hidden_au.min()
    places_m = FRAME.au_to_ned(places_au)
    told = BuiltUp(ground, FRAME, obstacles).hides(places_m, pose)
    assert np.all(told[is_hidden]), "a ray that meets an obstacle has no place on the ground"


@settings(max_examples=40, deadline=None)
@given(obstacle=blocks())
def test_what_is_hidden_is_told_no_larger_than_each_sector_needs(obstacle):
    """From the nearest of an obstacle that is in it, to the end of its farthest's shadow."""
    hidden_au = look(BuiltUp(FLAT, FRAME, [obstacle]), pose_over()).hidden_au
    shape, eye = shapely.Polygon(obstacle.corners_au), shapely.Point(EYE_AU)
    above_m = HEIGHT_M - obstacle.height_m
    stretch = HEIGHT_M / above_m if above_m > 0.0 else math.inf
    bearing = np.linspace(0.0, math.tau, len(hidden_au) + 1)
    rim_au = EYE_AU + np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    for sector, (first_au, last_au) in enumerate(hidden_au):
        part = shape & shapely.Polygon([EYE_AU, *rim_au[sector : sector + 2]])
        if part.area < 1e-9:
            continue
        nearest_au, corners_au = part.distance(eye), shapely.get_coordinates(part)
        farthest_au = stretch * np.linalg.norm(corners_au - EYE_AU, axis=-1).max()
        is_out = nearest_au >= SENSOR_RADIUS_AU
        assert first_au == pytest.approx(min(nearest_au, SENSOR_RADIUS_AU), abs=1.01e-4)
        told_au = SENSOR_RADIUS_AU if is_out else min(farthest_au, SENSOR_RADIUS_AU)
        assert last_au == pytest.approx(told_au, abs=1.01e-4)


def test_along_a_street_all_ground_counts_up_to_its_walls():
    street = [box((0.2, 0.5), (0.35, 0.9)), box((0.45, 0.5), (0.6, 0.9))]
    seen = look(BuiltUp(FLAT, FRAME, street), pose_over())
    assert seen.view_au == pytest.approx(0.05, abs=1e-3)
    along = beside([0.0, 0.095], [0.0, -0.095], [0.045, 0.0], [-0.03, 0.08])
    assert is_in_view(seen, along).all()
    behind = beside([0.055, 0.0], [-0.09, 0.0], [0.06, 0.07])
    assert not is_in_view(seen, behind).any()


def test_over_a_tree_ground_beyond_its_shadow_counts():
    tree = box(EYE_AU - 0.01, EYE_AU + 0.01, height_m=12.0)
    seen = look(BuiltUp(FLAT, FRAME, [tree]), pose_over())
    assert seen.view_au == 0.0
    reach_au = 0.01 * HEIGHT_M / (HEIGHT_M - 12.0)
    for away_au, is_seen in ((0.9 * reach_au, False), (1.5 * reach_au, True), (0.099, True)):
        assert is_in_view(seen, beside(away_au, 0.0)) == is_seen


@pytest.mark.parametrize("at_au", [EYE_AU, beside(0.02, 0.0), beside(0.02, 0.02)])
def test_right_over_an_edge_nothing_of_the_obstacle_is_called_seen(at_au):
    """Where the camera is exactly above a wall or a corner."""
    wood = box(EYE_AU - 0.02, EYE_AU + 0.02)
    seen = look(BuiltUp(FLAT, FRAME, [wood]), pose_over(at_au))
    grid = EYE_AU + np.random.default_rng(1).uniform(-0.0199, 0.0199, (500, 2))
    assert not is_in_view(seen, grid).any()


def test_right_over_a_slanted_edge_too():
    """Where rounding decides on which side of it the camera is."""
    rng = np.random.default_rng(2)
    for _ in range(40):
        wood = block(*(EYE_AU + rng.uniform(-0.08, 0.08, (3, 2))))
        edge_au, share = wood.corners_au[:2], rng.random()
        over_au = edge_au[0] + share * (edge_au[1] - edge_au[0])
        seen = look(BuiltUp(FLAT, FRAME, [wood]), pose_over(over_au))
        within_au = rng.dirichlet(np.ones(3), 200) @ wood.corners_au
        assert not is_in_view(seen, within_au).any()


def test_a_tower_higher_than_the_drone_hides_all_behind_it():
    tower = box(beside(0.02, -0.01), beside(0.03, 0.01), height_m=80.0)
    seen = look(BuiltUp(FLAT, FRAME, [tower]), pose_over())
    assert is_in_view(seen, beside(0.019, 0.0))
    assert not is_in_view(seen, beside(0.0999, 0.0))
    assert is_in_view(seen, beside(-0.0999, 0.0))


def test_what_a_tilt_leaves_in_the_picture_is_all_that_counts():
    tree = box(beside(0.01, 0.0), beside(0.02, 0.01), height_m=1.0)
    pose = pose_over(attitude=(0.0, 0.5, 0.0))
    bare = look(FLAT, pose)
    assert bare.view_au < SENSOR_RADIUS_AU
    seen, places_au = look(BuiltUp(FLAT, FRAME, [tree]), pose), places_about()
    assert not np.any(is_in_view(seen, places_au) & ~is_in_view(bare, places_au))
    away = beside([-0.9 * bare.view_au, 0.0], [-1.1 * bare.view_au, 0.0])
    assert is_in_view(seen, away).tolist() == [True, False]


def test_where_nothing_stands_nothing_is_said_of_it():
    seen = look(FLAT, pose_over())
    assert seen.hidden_au is None
    assert seen.view_au == SENSOR_RADIUS_AU


def test_a_find_on_a_roof_or_behind_it_is_of_no_place():
    roof = box(beside(0.03, -0.03), beside(0.06, 0.03))
    surface, pose = BuiltUp(FLAT, FRAME, [roof]), pose_over()
    for away_au, is_seen in ((0.028, True), (0.04, False), (0.07, False), (0.099, False)):
        at_m = FRAME.au_to_ned(beside(away_au, 0.0))
        u, v = ground_to_pixel(at_m, CAMERA, pose, FRAME.ground_down_m)
        found = Detection(appearance="cow", pixel_px=(u, v), score=0.9)
        assert look(surface, pose, [found]).seen[0] == is_seen
        place_m = surface.places(np.array([u, v]), CAMERA, pose)
        np.testing.assert_allclose(place_m, at_m if is_seen else [np.nan, np.nan], atol=1e-9)


def test_tops_stand_on_the_highest_ground_below_them():
    """On a hill of 9 m a hut hides more than on flat ground, and unknown ground hides all."""
    hut = box(beside(0.02, -0.02), beside(0.05, 0.02), height_m=5.0)

    class Unknown(Plane):
        def down_m(self, place_ned_m):
            return np.where(FRAME.ned_to_au(place_ned_m)[..., 0] > 0.44, np.nan, self._down_m)

    ends = [
        look(BuiltUp(ground, FRAME, [hut]), pose_over()).hidden_au[0, 1]
        for ground in (FLAT, HILLS, Unknown(FRAME.ground_down_m))
    ]
    assert ends[0] < ends[1] < ends[2] == SENSOR_RADIUS_AU
