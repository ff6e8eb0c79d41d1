"""The paper's sensor: what counts as seen, and where."""

import math

import numpy as np
import pytest

from dronemon.frames import AreaFrame, ground_to_pixel
from dronemon.sightings import Sightings
from dronemon.types import APPEARANCES, CameraModel, Detection, Pose
from dronemon.vision.drawn import DrawnDetector
from dronemon.vision.observe import observe
from dronemon.vision.owners import Owners
from dronemon.vision.surface import Plane
from sim.renderer import Renderer
from sim.scene import Animal, Scene

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
FRAME = AreaFrame(
    centre_ned_m=(40.0, -25.0),
    ground_down_m=1.5,
    side_m=200.0,
    heading_rad=0.5,
    cruise_speed_m_s=5.0,
)
AGENT_AU = np.array([0.3, 0.8])


def pose_over(agent_au, attitude=(0.1, -0.2, 2.0), height_m=35.0):
    north_m, east_m = FRAME.au_to_ned(agent_au)
    return Pose(
        time_s=12.0,
        position_ned_m=(north_m, east_m, FRAME.ground_down_m - height_m),
        velocity_ned_m_s=(3.0, 0.0, 0.0),
        attitude_rad=attitude,
    )


def detection(appearance, at_au, pose, score=0.9):
    at_m = FRAME.au_to_ned(np.array(at_au))
    u, v = ground_to_pixel(at_m, CAMERA, pose, FRAME.ground_down_m)
    return Detection(appearance=appearance, pixel_px=(u, v), score=score)


def observe_over(detections, pose, appearances=("cow", "fox", "zebra")):
    measurement, _ = observe(
        detections,
        pose=pose,
        camera=CAMERA,
        frame=FRAME,
        surface=Plane(FRAME.ground_down_m),
        owners=Owners(appearances),
        sightings=Sightings(np.full((len(appearances), 2), np.nan)),
        time_au=4.5,
    )
    return measurement


def test_targets_are_in_order_and_unseen_ones_have_no_place():
    pose = pose_over(AGENT_AU)
    seen = observe_over([detection("zebra", (0.33, 0.76), pose)], pose)
    assert seen.time_au == 4.5
    np.testing.assert_allclose(seen.agent_au, AGENT_AU)
    np.testing.assert_array_equal(seen.seen, [False, False, True])
    np.testing.assert_allclose(seen.target_au[2], (0.33, 0.76))
    assert np.isnan(seen.target_au[:2]).all()


@pytest.mark.parametrize(("distance_au", "is_seen"), [(0.099, True), (0.101, False)])
def test_only_the_circle_counts(distance_au, is_seen):
    pose = pose_over(AGENT_AU, attitude=(0.0, 0.0, 1.0))
    for bearing in np.linspace(0.0, 6.0, 7):
        at_au = AGENT_AU + distance_au * np.array([math.cos(bearing), math.sin(bearing)])
        assert observe_over([detection("cow", at_au, pose)], pose).seen[0] == is_seen


@pytest.mark.parametrize("order", [1, -1])
def test_higher_score_wins_and_only_inside_the_circle(order):
    pose = pose_over(AGENT_AU)
    finds = [
        detection("cow", (0.31, 0.81), pose, score=0.6),
        detection("cow", (0.35, 0.80), pose, score=0.8),
        detection("cow", (0.45, 0.80), pose, score=0.99),
    ]
    seen = observe_over(finds[::order], pose)
    np.testing.assert_allclose(seen.target_au[0], (0.35, 0.80))


@pytest.mark.parametrize(
    ("pitch_deg", "view_au"),
    [(0.0, 0.1), (7.0, 0.1), (12.0, 35.0 * math.tan(math.radians(24.87)) / 200.0), (40.0, 0.0)],
)
def test_only_what_a_tilt_leaves_in_the_picture_was_looked_at(pitch_deg, view_au):
    """Up and down the picture it looks 36.87 degrees to either side."""
    pose = pose_over(AGENT_AU, attitude=(0.0, math.radians(pitch_deg), 1.0))
    seen = observe_over([detection("cow", AGENT_AU + 0.01, pose)], pose)
    assert seen.view_au == pytest.approx(view_au, abs=1e-5)
    assert seen.view_au <= 0.1
    assert seen.seen.tolist() == [True, False, False]


def test_nothing_found_and_nobody_asked_for():
    pose = pose_over(AGENT_AU)
    seen = observe_over([detection("tiger", (0.3, 0.8), pose)], pose)
    assert not seen.seen.any()
    assert not observe_over([], pose).seen.any()


@pytest.mark.parametrize("heading_rad", [0.0, 0.9, -2.0])
def test_rendered_animals_are_observed_where_they_are(heading_rad):
    """From world to measurement, with the area's turn written out by hand."""
    side_m, centre = 200.0, np.array([15.0, 80.0])
    north_side = np.array([math.cos(heading_rad), math.sin(heading_rad)])
    east_side = np.array([-math.sin(heading_rad), math.cos(heading_rad)])

    def place(x_au, y_au):
        offset = side_m * ((x_au - 0.5) * east_side + (y_au - 0.5) * north_side)
        return tuple(float(v) for v in centre + offset)

    truth_au = {"tiger": (0.72, 0.22), "sheep": (0.66, 0.14), "horse": (0.74, 0.15)}
    agent_au = (0.70, 0.18)
    frame = AreaFrame(
        centre_ned_m=(15.0, 80.0),
        ground_down_m=0.0,
        side_m=side_m,
        heading_rad=heading_rad,
        cruise_speed_m_s=5.0,
    )
    pose = Pose(
        time_s=1.0,
        position_ned_m=(*place(*agent_au), -36.0),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=(-0.12, 0.15, 1.1),
    )
    animals = tuple(
        Animal(name=n, appearance=n, position_ned_m=place(*at), heading_rad=0.4, walked_m=1.0)
        for n, at in truth_au.items()
    )
    scene = Scene(pose=pose, frame=frame, animals=animals)
    image = Renderer(CAMERA, 10_300).render(scene)
    found = DrawnDetector(APPEARANCES, CAMERA, 0.5).detect(image, pose, 0.0)
    seen, owners = observe(
        found,
        pose=pose,
        camera=CAMERA,
        frame=frame,
        surface=Plane(0.0),
        owners=Owners(tuple(truth_au)),
        sightings=Sightings(np.full((3, 2), np.nan)),
        time_au=0.1,
    )
    assert sorted(owners) == [0, 1, 2]
    assert seen.seen.all()
    np.testing.assert_allclose(seen.agent_au, agent_au, atol=1e-9)
    np.testing.assert_allclose(seen.target_au, list(truth_au.values()), atol=0.6 / side_m)
