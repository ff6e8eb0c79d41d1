"""What every detector owes a flight, on pictures whose projection is not the application's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from squares import write_squares

from dronemon.frames import AreaFrame
from dronemon.mission.detector import DetectorSection
from dronemon.types import CameraModel, Detection, ImageArray, Pose
from dronemon.vision.blobs import BlobDetector
from dronemon.vision.boxed import BoxDetector
from dronemon.vision.detector import Detector
from dronemon.vision.drawn import DrawnDetector
from dronemon.vision.markers import MarkerDetector
from sim.renderer import Renderer
from sim.scene import Animal, Scene

CAMERA = CameraModel(width_px=320, height_px=240, horizontal_fov_rad=math.pi / 2.0)
GROUND_DOWN_M = 2.0

ANIMALS = ("cow", "tiger")
ORANGE = DetectorSection(kind="blobs", hue_deg=(15.0, 40.0), saturation=0.6)


@dataclass(frozen=True, kw_only=True)
class Case:
    """A detector, what it is to find, and a picture that shows that and something else."""

    make: Callable[[], Detector]
    watched: frozenset[str]
    picture: ImageArray


def drawn() -> Case:
    return Case(
        make=lambda: DrawnDetector(ANIMALS, CAMERA, min_score=0.5),
        watched=frozenset(ANIMALS),
        picture=render({"cow": (4.0, -6.0), "tiger": (-5.0, 5.0), "fox": (0.0, 0.0)}),
    )


def boxed(folder: Path) -> Case:
    path = write_squares(folder / "squares.onnx", size_px=(320, 240))
    section = DetectorSection(kind="onnx", file=str(path))
    image = meadow()
    for row, colour in ((60, (20, 20, 240)), (120, (240, 20, 20)), (180, (20, 240, 20))):
        image[row - 12 : row + 12, 108:132] = colour
    return Case(
        make=lambda: BoxDetector(section, ("red",), CAMERA),
        watched=frozenset({"red"}),
        picture=image,
    )


def markers() -> Case:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    image = np.full_like(meadow(), 255)
    for number, column in ((3, 40), (17, 130), (30, 220)):
        marker = cv2.aruco.generateImageMarker(dictionary, number, 48)
        image[90:138, column : column + 48] = marker[..., None]
    section = DetectorSection(kind="markers", family="4x4_50", side_m=6.0)
    return Case(
        make=lambda: MarkerDetector(section, ("3", "30"), CAMERA),
        watched=frozenset({"3", "30"}),
        picture=image,
    )


def blobs() -> Case:
    image = meadow()
    cv2.circle(image, (90, 120), 8, (30, 130, 250), -1)
    cv2.circle(image, (200, 120), 8, (250, 130, 30), -1)
    return Case(
        make=lambda: BlobDetector(ORANGE, "boat", CAMERA),
        watched=frozenset({"boat"}),
        picture=image,
    )


def meadow() -> ImageArray:
    return np.full((CAMERA.height_px, CAMERA.width_px, 3), (62, 128, 104), np.uint8)


@pytest.fixture(scope="module", params=["drawn", "boxed", "markers", "blobs"])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    if request.param == "boxed":
        return boxed(tmp_path_factory.mktemp("boxed"))
    return {"drawn": drawn, "markers": markers, "blobs": blobs}[request.param]()


def pose(height_m: float = 20.0, attitude: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Pose:
    return Pose(
        time_s=1.0,
        position_ned_m=(0.0, 0.0, GROUND_DOWN_M - height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=attitude,
    )


def render(at_m: dict[str, tuple[float, float]]) -> ImageArray:
    """Animals at places on the ground."""
    frame = AreaFrame(
        centre_ned_m=(0.0, 0.0),
        ground_down_m=GROUND_DOWN_M,
        side_m=100.0,
        heading_rad=0.0,
        cruise_speed_m_s=5.0,
    )
    animals = tuple(
        Animal(name=name, appearance=name, position_ned_m=place_m, heading_rad=0.4, walked_m=1.0)
        for name, place_m in at_m.items()
    )
    scene = Scene(pose=pose(), frame=frame, animals=animals)
    return Renderer(CAMERA, 10_300).render(scene)


def look(detector: Detector, image: ImageArray, at: Pose) -> tuple[Detection, ...]:
    return detector.detect(image, at, GROUND_DOWN_M)


@pytest.mark.lengthy
def test_only_what_is_watched_is_found_and_on_the_picture(case: Case) -> None:
    found = look(case.make(), case.picture, pose())
    assert {d.appearance for d in found} == case.watched
    for detection in found:
        assert 0.0 <= detection.score <= 1.0
        assert 0.0 <= detection.pixel_px[0] <= CAMERA.width_px
        assert 0.0 <= detection.pixel_px[1] <= CAMERA.height_px


def test_the_picture_stays_as_it_is(case: Case) -> None:
    before = case.picture.copy()
    look(case.make(), case.picture, pose())
    np.testing.assert_array_equal(case.picture, before)


def test_nothing_is_remembered_from_picture_to_picture(case: Case) -> None:
    detector = case.make()
    first = look(detector, case.picture, pose())
    nothing = np.zeros_like(case.picture)
    assert look(detector, nothing, pose(attitude=(0.2, 0.1, 2.0))) == ()
    assert look(detector, case.picture, pose()) == first


@pytest.mark.parametrize("height_m", [0.0, 0.5, 400.0])
@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.0, 1.2, 0.0), (3.0, 0.0, 1.0)])
def test_any_pose_is_taken(
    case: Case, height_m: float, attitude: tuple[float, float, float]
) -> None:
    assert isinstance(look(case.make(), case.picture, pose(height_m, attitude)), tuple)
