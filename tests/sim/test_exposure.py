"""Pictures that are less kind: each setting against the same picture without it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from dronemon.frames import AreaFrame
from dronemon.mission.schema import Simulation
from dronemon.types import CameraModel, Pose
from sim.camera import encode
from sim.renderer import Renderer
from sim.scene import Animal, Scene

CAMERA = CameraModel(width_px=320, height_px=240, horizontal_fov_rad=math.pi / 2.0)
SEED = 10_300
HEIGHT_M = 16.0
PX_PER_M = CAMERA.focal_px / HEIGHT_M
CAR = Animal(
    name="car",
    appearance="car-white",
    position_ned_m=(0.0, 0.0),
    heading_rad=0.0,
    walked_m=0.0,
)


def scene_of(velocity_m_s=(0.0, 0.0, 0.0), turn_rad_s=(0.0, 0.0, 0.0)):
    pose = Pose(
        time_s=3.0,
        position_ned_m=(0.0, 0.0, -HEIGHT_M),
        velocity_ned_m_s=velocity_m_s,
        attitude_rad=(0.0, 0.0, 0.0),
    )
    frame = AreaFrame(
        centre_ned_m=(5000.0, 5000.0),
        ground_down_m=0.0,
        side_m=200.0,
        heading_rad=0.0,
        cruise_speed_m_s=5.0,
    )
    return Scene(pose=pose, frame=frame, animals=(CAR,), turn_rad_s=turn_rad_s)


@cache
def renderer_of(**unkind):
    return Renderer(CAMERA, SEED, Simulation(**unkind))


def picture(scene=None, **unkind):
    """-> (height, width, 3) as numbers that can be taken from each other"""
    return renderer_of(**unkind).render(scene or scene_of()).astype(np.float64)


@pytest.mark.parametrize(
    ("velocity_m_s", "turn_rad_s"),
    [
        ((10.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, -10.0, 4.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.6, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, -0.6, 0.0)),
        ((3.0, 0.0, 0.0), (0.0, 0.3, 1.0)),
    ],
)
def test_an_open_shutter_sees_the_mean_of_what_it_passes(velocity_m_s, turn_rad_s):
    scene = scene_of(velocity_m_s, turn_rad_s)
    passed = [replace(scene, pose=scene.pose_after(t)) for t in np.linspace(-0.05, 0.05, 15)]
    mean = np.mean([picture(one) for one in passed], axis=0)
    blurred = picture(scene, exposure_s=0.1)
    inner = np.s_[30:-30, 30:-30]  # what comes in from outside is not known
    off = np.abs(cv2.GaussianBlur(blurred - mean, (0, 0), 2.0))[inner]  # without the noise
    sharp_off = np.abs(cv2.GaussianBlur(picture(scene) - mean, (0, 0), 2.0))[inner]
    # What stands above the ground moves a little further than the ground.
    assert np.quantile(off, 0.99) < 0.35 * np.quantile(sharp_off, 0.99)


def test_without_motion_the_shutter_may_stay_open():
    np.testing.assert_array_equal(picture(exposure_s=0.1), picture())


def test_low_light_is_noisy_first_and_then_dark():
    def noise(image):
        return (image - cv2.GaussianBlur(image, (0, 0), 2.0))[150:, :, 1].std()

    day, dusk, night = picture(), picture(light=1.0 / 16.0), picture(light=1.0 / 64.0)
    assert dusk.mean() == pytest.approx(day.mean(), rel=0.03)
    assert 2.5 < noise(dusk) / noise(day) < 4.5
    assert night.mean() == pytest.approx(day.mean() / 4.0, rel=0.2)


def test_clouds_shade_half_of_the_ground_and_stay_there():
    def shade(north_m):
        pose = replace(scene_of().pose, position_ned_m=(north_m, 70.0, -60.0))
        scene = replace(scene_of(), pose=pose, animals=())
        return picture(scene, shadow=0.6) / np.maximum(picture(scene), 1.0)

    light = np.concatenate([shade(80.0 * i)[..., 1].ravel() for i in range(3)])
    assert np.quantile(light, [0.02, 0.98]) == pytest.approx([0.4, 1.0], abs=0.05)
    assert 0.2 < (light < 0.7).mean() < 0.8
    px_per_m = CAMERA.focal_px / 60.0
    shift = round(12.0 * px_per_m)
    here, there = shade(0.0)[..., 1], shade(12.0)[..., 1]
    np.testing.assert_allclose(there[shift:], here[:-shift], atol=0.15)


def test_a_poor_jpeg_is_small_and_loses_the_colours_of_what_is_small():
    image = picture().astype(np.uint8)
    fine, poor = encode(image, 95), encode(image, 30)
    assert len(poor) < 0.4 * len(fine)

    spot = np.full((64, 64, 3), (62, 128, 104), np.uint8)
    spot[31:33, 31:33] = (20, 115, 250)

    def colour(quality):
        shown = cv2.imdecode(np.frombuffer(encode(spot, quality), np.uint8), cv2.IMREAD_COLOR)
        return float(np.ptp(shown[31:33, 31:33].mean(axis=(0, 1))))

    assert colour(95) > 200.0
    assert colour(75) < 0.75 * colour(95)
