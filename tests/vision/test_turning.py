"""Pictures turn with the vehicle, later: by how much, and what is said where it cannot be told."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dronemon.errors import CameraError
from dronemon.frames import AreaFrame
from dronemon.types import CameraModel, FloatArray, ImageArray, Pose
from dronemon.vision.turning import MAX_LATENCY_S, latency_of, turn_between
from sim.renderer import Renderer
from sim.scene import Scene

CAMERA = CameraModel(width_px=320, height_px=240, horizontal_fov_rad=math.pi / 2.0)
FRAME = AreaFrame(
    centre_ned_m=(0.0, 0.0),
    ground_down_m=0.0,
    side_m=200.0,
    heading_rad=0.0,
    cruise_speed_m_s=5.0,
)
TIMES_S = np.arange(0.0, 20.0, 0.02)


def yaw_rad(time_s: FloatArray) -> FloatArray:
    """To and fro, unevenly, and through south, where a compass jumps."""
    turn = math.pi + sum(0.3 * np.sin(rate * time_s) for rate in (1.3, 3.1, 4.7))
    return (turn + math.pi) % math.tau - math.pi


def seen(renderer: Renderer, turned_rad: float, roll_rad: float = 0.0) -> ImageArray:
    pose = Pose(
        time_s=1.0,
        position_ned_m=(3.0, 4.0, -10.0),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=(roll_rad, 0.0, turned_rad),
    )
    return renderer.render(Scene(pose=pose, frame=FRAME, animals=()))


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(CAMERA, 10_000)


@pytest.mark.lengthy
@pytest.mark.parametrize("turn_deg", [-6.0, -1.0, 0.0, 3.0])
def test_the_turn_between_two_pictures_is_the_cameras(renderer: Renderer, turn_deg: float) -> None:
    before, after = seen(renderer, 2.0), seen(renderer, 2.0 + math.radians(turn_deg), 0.02)
    turn_rad = turn_between(before, after)
    assert turn_rad is not None
    assert math.degrees(turn_rad) == pytest.approx(turn_deg, abs=0.15)


def test_pictures_with_nothing_in_common_tell_no_turn(renderer: Renderer) -> None:
    grey = np.full((240, 320, 3), 120, np.uint8)
    noise = np.random.default_rng(10_000).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    assert turn_between(grey, grey) is None
    assert turn_between(seen(renderer, 0.0), noise) is None


def pairs(latency_s: float, noise_rad: float = 0.0) -> tuple[FloatArray, FloatArray]:
    taken_s = np.arange(0.5, 19.0 - latency_s, 0.1)
    rng = np.random.default_rng(10_000)
    turns = np.diff(np.unwrap(yaw_rad(taken_s))) + noise_rad * rng.normal(size=len(taken_s) - 1)
    return np.stack([taken_s[:-1], taken_s[1:]], axis=1) + latency_s, turns


@pytest.mark.parametrize("latency_s", [0.0, 0.137, 0.9])
def test_a_latency_is_found_with_its_error(latency_s: float) -> None:
    arrived_s, turns_rad = pairs(latency_s, noise_rad=0.01)
    found = latency_of(arrived_s, turns_rad, TIMES_S, yaw_rad(TIMES_S))
    assert found.latency_s == pytest.approx(latency_s, abs=max(3.0 * found.error_s, 1e-3))
    assert 1e-4 < found.error_s < 0.01
    assert found.agreement > 0.95


def test_no_noise_no_error() -> None:
    found = latency_of(*pairs(0.3), TIMES_S, yaw_rad(TIMES_S))
    assert found.latency_s == pytest.approx(0.3, abs=1e-3)
    assert found.error_s < 1e-3


def test_what_says_too_little_or_does_not_fit_is_refused() -> None:
    arrived_s, turns_rad = pairs(0.2)
    yaws_rad = yaw_rad(TIMES_S)
    with pytest.raises(CameraError, match="20 pictures could be compared"):
        latency_of(arrived_s[40:60], turns_rad[40:60], TIMES_S, yaws_rad)
    with pytest.raises(CameraError, match="0 pictures could be compared"):
        latency_of(arrived_s, turns_rad, TIMES_S + 20.0, yaws_rad)
    with pytest.raises(CameraError, match="turn it faster"):
        latency_of(arrived_s, 0.01 * turns_rad, TIMES_S, 0.01 * np.unwrap(yaws_rad))
    with pytest.raises(CameraError, match="the other way"):
        latency_of(arrived_s, -turns_rad, TIMES_S, yaws_rad)
    strange = np.random.default_rng(10_000).normal(size=len(turns_rad)) * 0.1
    with pytest.raises(CameraError, match="turn it to and fro"):
        latency_of(arrived_s, strange, TIMES_S, yaws_rad)
    late_s, late_rad = pairs(MAX_LATENCY_S + 0.03)
    with pytest.raises(CameraError, match="older than 2 s"):
        latency_of(late_s, late_rad, TIMES_S, yaws_rad)
