"""The detector on rendered pictures, whose projection is not the application's."""

import math

import cv2
import numpy as np
import pytest

from dronemon.frames import AreaFrame, pixel_to_ground
from dronemon.types import ANIMALS, APPEARANCES, PEOPLE, VEHICLES, CameraModel, Pose
from dronemon.vision.drawn import DrawnDetector
from dronemon.vision.prototypes import PROTOTYPES
from sim.renderer import Renderer
from sim.scene import Animal, Scene
from sim.sprites import drawn_size_m

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
GROUND_DOWN_M = -2.5
AT = (-31.0, 64.0)


@pytest.fixture(scope="module")
def renderer():
    return Renderer(CAMERA, 10_300)


@pytest.fixture(scope="module")
def detector():
    return DrawnDetector(ANIMALS, CAMERA, min_score=0.5)


def scene_of(*animals, attitude=(0.0, 0.0, 0.0), height_m=35.0):
    pose = Pose(
        time_s=1.0,
        position_ned_m=(*AT, GROUND_DOWN_M - height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=attitude,
    )
    frame = AreaFrame(
        centre_ned_m=AT,
        ground_down_m=GROUND_DOWN_M,
        side_m=200.0,
        heading_rad=0.3,
        cruise_speed_m_s=5.0,
    )
    return Scene(pose=pose, frame=frame, animals=tuple(animals))


def animal_at(appearance, north_m, east_m, heading_rad=0.0):
    """An animal at a place relative to the vehicle."""
    return Animal(
        name=appearance,
        appearance=appearance,
        position_ned_m=(AT[0] + north_m, AT[1] + east_m),
        heading_rad=heading_rad,
        walked_m=3.0,
    )


def detect(detector, renderer, scene):
    """-> appearance to (north, east) relative to the vehicle, of what was found"""
    found = detector.detect(renderer.render(scene), scene.pose, GROUND_DOWN_M)
    assert len({d.appearance for d in found}) == len(found)
    pixels = np.array([d.pixel_px for d in found]).reshape(-1, 2)
    places = pixel_to_ground(pixels, CAMERA, scene.pose, GROUND_DOWN_M) - AT
    return {d.appearance: tuple(at) for d, at in zip(found, places, strict=True)}


@pytest.mark.lengthy
@pytest.mark.parametrize("appearance", APPEARANCES)
@pytest.mark.parametrize("heading_rad", [0.2, 1.9, -2.5])
def test_each_appearance_is_named_and_located(renderer, appearance, heading_rad):
    detector = DrawnDetector(APPEARANCES, CAMERA, min_score=0.5)
    scene = scene_of(animal_at(appearance, -7.0, 11.0, heading_rad), height_m=33.0)
    found = detect(detector, renderer, scene)
    assert list(found) == [appearance]
    assert found[appearance] == pytest.approx((-7.0, 11.0), abs=0.6)


@pytest.mark.lengthy
@pytest.mark.parametrize(
    "attitude",
    [
        (0.26, 0.0, 0.0),
        (-0.26, 0.0, 0.0),
        (0.0, 0.26, 0.0),
        (0.0, -0.26, 0.0),
        (0.0, 0.0, 0.8),
        (0.0, 0.0, -2.4),
        (0.15, -0.2, 1.3),
        (-0.2, 0.12, 3.0),
    ],
)
def test_places_are_right_under_any_attitude(detector, renderer, attitude):
    places = {"tiger": (12.0, 3.0), "panda": (-4.0, 13.0), "sheep": (-10.0, -8.0)}
    animals = [animal_at(name, *at, heading_rad=0.7) for name, at in places.items()]
    found = detect(detector, renderer, scene_of(*animals, attitude=attitude))
    assert found.keys() == places.keys()
    for name, at in places.items():
        assert found[name] == pytest.approx(at, abs=0.6)


def test_whole_herd_is_found_at_once(detector, renderer):
    places = {
        name: (14.0 * math.cos(0.8 * i), 14.0 * math.sin(0.8 * i)) for i, name in enumerate(ANIMALS)
    }
    animals = [animal_at(name, *at, heading_rad=at[0]) for name, at in places.items()]
    assert detect(detector, renderer, scene_of(*animals)).keys() == set(ANIMALS)


@pytest.mark.lengthy
@pytest.mark.parametrize("appearances", [PEOPLE, VEHICLES])
def test_people_and_vehicles_are_told_apart_where_the_picture_has_the_detail(appearances):
    """Each in a row, from the greatest height that they are said to be found at."""
    needed_px_per_m = max(PROTOTYPES[name].needed_px_per_m for name in appearances)
    height_m = CAMERA.focal_px / needed_px_per_m
    spots = [(-0.5 + (i // 4) / 2.0, -0.6 + 0.4 * (i % 4)) for i in range(len(appearances))]
    animals = [
        animal_at(name, 0.5 * height_m * north, 0.9 * height_m * east, heading_rad=0.8 * i)
        for i, (name, (north, east)) in enumerate(zip(appearances, spots, strict=True))
    ]
    scene = scene_of(*animals, height_m=height_m)
    detector = DrawnDetector(appearances, CAMERA, min_score=0.5)
    assert detect(detector, Renderer(CAMERA, 10_301), scene).keys() == set(appearances)


def test_empty_ground_shows_nothing(detector, renderer):
    everything = DrawnDetector(APPEARANCES, CAMERA, min_score=0.5)
    for i in range(12):
        scene = scene_of(attitude=(0.1 * i - 0.4, 0.05, 0.8 * i), height_m=20.0 + 6.0 * i)
        assert detect(detector, renderer, scene) == {}
        assert detect(everything, renderer, scene) == {}


def test_animal_that_nobody_watches_is_not_taken_for_another(renderer):
    detector = DrawnDetector(["cow", "fox"], CAMERA, min_score=0.1)
    scene = scene_of(
        animal_at("zebra", 5.0, 5.0), animal_at("tiger", -5.0, 5.0), animal_at("fox", 0.0, -6.0)
    )
    assert list(detect(detector, renderer, scene)) == ["fox"]


def test_animal_across_the_edge_is_left_out(detector, renderer):
    half_width_m = 35.0  # at 35 m height, with 90 degrees
    inside = detect(detector, renderer, scene_of(animal_at("cow", 0.0, half_width_m - 6.0)))
    across = detect(detector, renderer, scene_of(animal_at("cow", 0.0, half_width_m - 1.0)))
    assert list(inside) == ["cow"]
    assert across == {}


@pytest.mark.parametrize("height_m", [12.0, 20.0, 50.0])
def test_other_heights_serve_too(detector, renderer, height_m):
    scene = scene_of(animal_at("cow", 3.0, -4.0), animal_at("tiger", -3.0, 5.0), height_m=height_m)
    assert detect(detector, renderer, scene).keys() == {"cow", "tiger"}


@pytest.mark.lengthy
def test_larger_pictures_serve_too():
    camera = CameraModel(width_px=1280, height_px=720, horizontal_fov_rad=1.2)
    scene = scene_of(animal_at("zebra", 6.0, -8.0), attitude=(0.1, -0.1, 2.0), height_m=40.0)
    image = Renderer(camera, 10_300).render(scene)
    (found,) = DrawnDetector(APPEARANCES, camera, 0.5).detect(image, scene.pose, GROUND_DOWN_M)
    place = pixel_to_ground(np.array(found.pixel_px), camera, scene.pose, GROUND_DOWN_M) - AT
    assert found.appearance == "zebra"
    assert place == pytest.approx((6.0, -8.0), abs=0.6)


@pytest.mark.lengthy
def test_random_flights_are_seen_almost_without_fault(detector, renderer):
    """A small version of benchmarks/vision.py, through the JPEG that the stream carries."""
    rng = np.random.default_rng(10_304)
    num_right, num_wrong, num_pictures = 0, 0, 60
    for i in range(num_pictures):
        name = ANIMALS[i % len(ANIMALS)]
        tilt_rad, towards = rng.uniform(0.0, 0.26), rng.uniform(0.0, math.tau)
        scene = scene_of(
            animal_at(name, *rng.uniform(-11.0, 11.0, 2), rng.uniform(0.0, math.tau)),
            attitude=(
                tilt_rad * math.sin(towards),
                tilt_rad * math.cos(towards),
                rng.uniform(-3, 3),
            ),
            height_m=rng.uniform(30.0, 42.0),
        )
        jpeg = cv2.imencode(".jpg", renderer.render(scene), [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        image = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
        names = [d.appearance for d in detector.detect(image, scene.pose, GROUND_DOWN_M)]
        num_right += name in names
        num_wrong += len([other for other in names if other != name])
    assert num_right >= 0.97 * num_pictures
    assert num_wrong == 0


def test_landed_vehicle_detects_nothing(detector, renderer):
    assert detect(detector, renderer, scene_of(animal_at("cow", 0.0, 0.0), height_m=0.0)) == {}


def test_view_over_the_horizon_is_no_problem(detector, renderer):
    scene = scene_of(animal_at("cow", 20.0, 0.0), attitude=(0.0, 0.9, 0.0))
    assert detect(detector, renderer, scene).keys() <= {"cow"}


def test_unknown_appearance_is_an_error():
    with pytest.raises(ValueError, match="unicorn"):
        DrawnDetector(["cow", "unicorn"], CAMERA, 0.5)


@pytest.mark.parametrize("appearance", APPEARANCES)
def test_both_sides_mean_the_same_size(appearance):
    length_m, _, height_m = drawn_size_m(appearance)
    prototype = PROTOTYPES[appearance]
    assert prototype.height_m == pytest.approx(height_m, abs=0.01)
    # Four standard deviations: less than all with a thin tail, more for what ends bluntly.
    assert 0.6 * length_m < prototype.length_m < 1.3 * length_m
