"""What stands in a simulated picture, and what is made of it from there on."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from dronemon.frames import AreaFrame
from dronemon.planner.particles import ParticleBelief
from dronemon.planner.settings import MotionSettings
from dronemon.sightings import Sightings, is_in_view
from dronemon.types import APPEARANCES, CameraModel, Obstacle, Pose
from dronemon.vision.built_up import BuiltUp
from dronemon.vision.drawn import DrawnDetector
from dronemon.vision.observe import observe
from dronemon.vision.owners import Owners
from dronemon.vision.surface import Plane
from sim.renderer import Renderer
from sim.scene import Animal, Scene

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
FRAME = AreaFrame(
    centre_ned_m=(15.0, 80.0),
    ground_down_m=0.5,
    side_m=250.0,
    heading_rad=-0.7,
    cruise_speed_m_s=5.0,
)
GROUND = Plane(FRAME.ground_down_m)
AGENT_AU = np.array([0.6, 0.4])
HEIGHT_M = 40.0
RENDERER = Renderer(CAMERA, 10_300)
COLUMNS, ROWS = (px.ravel() for px in np.meshgrid(np.arange(0, 640, 3), np.arange(0, 480, 3)))


def pose_over(agent_au, attitude=(-0.1, 0.12, 1.1)) -> Pose:
    return replace(
        Pose.level(HEIGHT_M),
        position_ned_m=(*FRAME.au_to_ned(agent_au), FRAME.ground_down_m - HEIGHT_M),
        attitude_rad=attitude,
    )


def box(centre_au, half_au, height_m) -> Obstacle:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half_au
    return Obstacle(corners_au=np.array(centre_au) + corners, height_m=height_m)


@pytest.mark.parametrize("height_m", [3.0, 15.0, 39.0, 60.0])
def test_pictures_show_obstacles_where_rays_meet_them(height_m):
    """The picture's projection is not that of the rays; OpenCV's edges are a pixel or two wide."""
    rng = np.random.default_rng(int(height_m))
    bearings, away_au = rng.uniform(0.0, math.tau, 3), rng.uniform(0.05, 0.15, 3)
    offsets_au = away_au[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
    blocks = [box(AGENT_AU + offset_au, (0.02, 0.03), height_m) for offset_au in offsets_au]
    pose = pose_over(AGENT_AU, (*rng.uniform(-0.3, 0.3, 2), 0.4))
    bare = Scene(pose=pose, frame=FRAME, animals=())
    shown = RENDERER.render(replace(bare, obstacles=tuple((block, 0.0) for block in blocks)))
    is_drawn = (shown != RENDERER.render(bare)).any(axis=-1).astype(np.uint8)
    around = np.ones((7, 7), np.uint8)
    near = cv2.dilate(is_drawn, around)
    inner = cv2.erode(is_drawn, around, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    pixels_px = np.stack([COLUMNS + 0.5, ROWS + 0.5], axis=-1)
    places_m = BuiltUp(GROUND, FRAME, blocks).places(pixels_px, CAMERA, pose)
    is_met = np.isnan(places_m[:, 0])
    assert 0.0 < is_met.mean() < 1.0
    assert np.all(near[ROWS, COLUMNS][is_met])
    assert np.all(is_met[inner[ROWS, COLUMNS] == 1])


def cow_at(place_au) -> Animal:
    north_m, east_m = FRAME.au_to_ned(np.array(place_au)).tolist()
    return Animal(
        name="Bella",
        appearance="cow",
        position_ned_m=(north_m, east_m),
        heading_rad=0.4,
        walked_m=1.0,
    )


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (-0.1, 0.12, 1.1)])
def test_an_animal_behind_a_block_is_not_seen_and_may_still_be_there(attitude):
    cow_au, pose = AGENT_AU + np.array([0.075, 0.0]), pose_over(AGENT_AU, attitude)
    block = box(AGENT_AU + np.array([0.045, 0.0]), (0.008, 0.05), 22.0)
    scene = Scene(pose=pose, frame=FRAME, animals=(cow_at(cow_au),))
    detector = DrawnDetector(APPEARANCES, CAMERA, 0.5)
    for obstacles, is_seen in (((), True), ((block,), False)):
        image = RENDERER.render(replace(scene, obstacles=tuple((on, 0.0) for on in obstacles)))
        found = detector.detect(image, pose, FRAME.ground_down_m)
        sightings = Sightings(cow_au[None])
        belief = ParticleBelief(cow_au[None], MotionSettings(), np.random.default_rng(0))
        measurement, _ = observe(
            found,
            pose=pose,
            camera=CAMERA,
            frame=FRAME,
            surface=BuiltUp(GROUND, FRAME, obstacles) if obstacles else GROUND,
            owners=Owners(("cow",)),
            sightings=sightings,
            time_au=0.01,
        )
        assert measurement.seen.tolist() == [is_seen]
        assert is_in_view(measurement, cow_au) == is_seen
        unseen = replace(measurement, seen=np.array([False]), target_au=np.full((1, 2), np.nan))
        sightings.add(unseen)
        belief.learn(sightings)
        away_au = np.linalg.norm(belief.targets[0].walkers[:, :2] - cow_au, axis=1)
        assert (away_au.max() < 0.01) == (not is_seen), "all are there, or none"
        assert (away_au.min() > 0.01) == is_seen
