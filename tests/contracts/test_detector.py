"""What every detector owes a flight, on pictures whose projection is not the application's."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from dronemon.errors import CameraError
from dronemon.frames import AreaFrame
from dronemon.types import CameraModel, Detection, ImageArray, Pose
from dronemon.vision.detector import Detector
from dronemon.vision.drawn import DrawnDetector
from sim.renderer import Renderer
from sim.scene import Animal, Scene

CAMERA = CameraModel(width_px=320, height_px=240, horizontal_fov_rad=math.pi / 2.0)
GROUND_DOWN_M = 2.0
WATCHED = ("cow", "tiger")

Make = Callable[[], Detector]
DETECTORS: dict[str, Make] = {"drawn": lambda: DrawnDetector(WATCHED, CAMERA, min_score=0.5)}


@pytest.fixture(params=DETECTORS)
def make(request: pytest.FixtureRequest) -> Make:
    return DETECTORS[request.param]


def pose(height_m: float = 20.0, attitude: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Pose:
    return Pose(
        time_s=1.0,
        position_ned_m=(0.0, 0.0, GROUND_DOWN_M - height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=attitude,
    )


@pytest.fixture(scope="module")
def picture() -> ImageArray:
    """A cow, a tiger, and a fox that nobody watches."""
    frame = AreaFrame(
        centre_ned_m=(0.0, 0.0),
        ground_down_m=GROUND_DOWN_M,
        side_m=100.0,
        heading_rad=0.0,
        cruise_speed_m_s=5.0,
    )
    animals = tuple(
        Animal(name=name, appearance=name, position_ned_m=at_m, heading_rad=0.4, walked_m=1.0)
        for name, at_m in {"cow": (4.0, -6.0), "tiger": (-5.0, 5.0), "fox": (0.0, 0.0)}.items()
    )
    scene = Scene(pose=pose(), frame=frame, animals=animals)
    return Renderer(CAMERA, 10_300).render(scene)


def look(detector: Detector, image: ImageArray, at: Pose) -> tuple[Detection, ...]:
    return detector.detect(image, at, GROUND_DOWN_M)


def test_only_what_is_watched_is_found_and_on_the_picture(make: Make, picture: ImageArray) -> None:
    found = look(make(), picture, pose())
    assert {d.appearance for d in found} == set(WATCHED)
    for detection in found:
        assert 0.0 <= detection.score <= 1.0
        assert 0.0 <= detection.pixel_px[0] <= CAMERA.width_px
        assert 0.0 <= detection.pixel_px[1] <= CAMERA.height_px


def test_the_picture_stays_as_it_is(make: Make, picture: ImageArray) -> None:
    before = picture.copy()
    look(make(), picture, pose())
    np.testing.assert_array_equal(picture, before)


def test_nothing_is_remembered_from_picture_to_picture(make: Make, picture: ImageArray) -> None:
    detector = make()
    first = look(detector, picture, pose())
    assert look(detector, np.zeros_like(picture), pose(attitude=(0.2, 0.1, 2.0))) == ()
    assert look(detector, picture, pose()) == first


@pytest.mark.parametrize("height_m", [0.0, 0.5, 400.0])
@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.0, 1.2, 0.0), (3.0, 0.0, 1.0)])
def test_any_pose_is_taken(
    make: Make, picture: ImageArray, height_m: float, attitude: tuple[float, float, float]
) -> None:
    assert isinstance(look(make(), picture, pose(height_m, attitude)), tuple)


def test_a_picture_of_another_size_is_the_cameras_error(make: Make) -> None:
    with pytest.raises(CameraError, match="camera"):
        look(make(), np.zeros((10, 20, 3), np.uint8), pose())
