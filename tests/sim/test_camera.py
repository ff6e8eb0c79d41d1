"""The simulated camera: geometry against hand-derived signs and dronemon.frames, and its server."""

import asyncio
import math
import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest

from dronemon.frames import AreaFrame, ground_to_pixel, pixel_to_ground
from dronemon.types import APPEARANCES, CameraModel, Pose
from sim.camera import CameraServer
from sim.renderer import Renderer
from sim.scene import Animal, Scene
from sim.sprites import drawn_size_m

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
SEED = 10_300
GROUND_DOWN_M = 4.0
FAR_FRAME = AreaFrame(
    centre_ned_m=(5000.0, 5000.0),
    ground_down_m=GROUND_DOWN_M,
    side_m=200.0,
    heading_rad=0.0,
    cruise_speed_m_s=5.0,
)


@pytest.fixture(scope="module")
def renderer():
    return Renderer(CAMERA, SEED)


def scene_of(*animals, attitude=(0.0, 0.0, 0.0), at=(0.0, 0.0), height_m=35.0, frame=FAR_FRAME):
    pose = Pose(
        time_s=3.0,
        position_ned_m=(at[0], at[1], GROUND_DOWN_M - height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=attitude,
    )
    return Scene(pose=pose, frame=frame, animals=tuple(animals))


def animal_at(north_m, east_m, appearance="sheep", heading_rad=0.0):
    return Animal(
        name=appearance,
        appearance=appearance,
        position_ned_m=(north_m, east_m),
        heading_rad=heading_rad,
        walked_m=0.0,
    )


def changed_pixels(renderer, scene, brighter_than=40):
    """(n, 2) u, v of the pixels that the scene's animals make much brighter."""
    without = renderer.render(replace(scene, animals=())).astype(int)
    change = (renderer.render(scene).astype(int) - without).min(axis=-1)
    rows, columns = np.nonzero(change > brighter_than)
    return np.stack([columns, rows], axis=-1) + 0.5


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("attitude", "place", "side"),
    [
        ((0.0, 0.0, 0.0), (15.0, 0.0), "top"),
        ((0.0, 0.0, 0.0), (0.0, 15.0), "right"),
        ((0.0, 0.0, math.pi / 2.0), (0.0, 15.0), "top"),
        ((0.0, 0.0, math.pi / 2.0), (15.0, 0.0), "left"),
        # Nose up: the camera looks ahead, and what is below moves towards the tail.
        ((0.0, 0.3, 0.0), (0.0, 0.0), "bottom"),
        # Right side down: the camera looks to the left, and what is below moves to the right.
        ((0.3, 0.0, 0.0), (0.0, 0.0), "right"),
    ],
)
def test_picture_shows_animal_on_the_side_where_it_is(renderer, attitude, place, side):
    u, v = changed_pixels(renderer, scene_of(animal_at(*place), attitude=attitude)).mean(axis=0)
    right, down = u - CAMERA.width_px / 2.0, v - CAMERA.height_px / 2.0
    along = {"top": -down, "bottom": down, "right": right, "left": -right}[side]
    across = right if side in ("top", "bottom") else down
    assert along > 60.0
    assert abs(across) < 12.0


@pytest.mark.parametrize(
    "attitude",
    [
        (0.0, 0.0, 0.0),
        (0.25, 0.0, 0.0),
        (0.0, 0.25, 0.0),
        (0.0, 0.0, 2.0),
        (0.2, -0.15, -1.0),
        (-0.1, 0.22, 2.9),
    ],
)
def test_picture_agrees_with_frames(renderer, attitude):
    place = (117.0 + 6.0, -48.0 - 9.0)
    scene = scene_of(animal_at(*place), attitude=attitude, at=(117.0, -48.0))
    pixels = changed_pixels(renderer, scene)
    trunk_down_m = GROUND_DOWN_M - drawn_size_m("sheep")[2]
    located = pixel_to_ground(pixels, CAMERA, scene.pose, trunk_down_m).mean(axis=0)
    # Only the woolly part is bright, without the black head: half a metre behind the centre.
    assert located == pytest.approx((place[0] - 0.35, place[1]), abs=0.3)


@pytest.mark.parametrize("up_m", [-12.0, 8.0])
def test_an_animal_stands_on_its_own_ground(renderer, up_m):
    """Uphill it is shown as from so much less high."""
    animal = replace(animal_at(123.0, -57.0), up_m=up_m)
    scene = scene_of(animal, attitude=(0.1, -0.2, 1.0), at=(117.0, -48.0), height_m=30.0)
    trunk_down_m = GROUND_DOWN_M - up_m - drawn_size_m("sheep")[2]
    located = pixel_to_ground(changed_pixels(renderer, scene), CAMERA, scene.pose, trunk_down_m)
    assert located.mean(axis=0) == pytest.approx((123.0 - 0.35, -57.0), abs=0.3)


@pytest.mark.parametrize("heading_rad", [0.0, 1.0, -2.2])
def test_nose_points_along_the_heading(renderer, heading_rad):
    scene = scene_of(animal_at(3.0, 2.0, heading_rad=heading_rad), height_m=15.0)
    wool = pixel_to_ground(changed_pixels(renderer, scene), CAMERA, scene.pose, GROUND_DOWN_M)
    image = renderer.render(scene).astype(int)
    rows, columns = np.nonzero(image.max(axis=-1) < 32)
    black = np.stack([columns, rows], axis=-1) + 0.5
    head = pixel_to_ground(black, CAMERA, scene.pose, GROUND_DOWN_M)
    towards_head = head.mean(axis=0) - wool.mean(axis=0)
    bearing = math.atan2(towards_head[1], towards_head[0])
    assert math.remainder(bearing - heading_rad, math.tau) == pytest.approx(0.0, abs=0.25)


def test_tape_marks_the_turned_area(renderer):
    frame = replace(FAR_FRAME, centre_ned_m=(30.0, -20.0), heading_rad=0.6, side_m=40.0)
    scene = scene_of(at=(40.0, -10.0), attitude=(0.1, -0.1, 0.4), frame=frame)
    bare = renderer.render(replace(scene, frame=FAR_FRAME)).astype(int)
    tape = np.abs(renderer.render(scene).astype(int) - bare).max(axis=-1) > 12
    tape = cv2.dilate(tape.astype(np.uint8), np.ones((3, 3), np.uint8))

    def is_tape(x_au, y_au):
        at = frame.au_to_ned(np.array([x_au, y_au]))
        u, v = ground_to_pixel(at, CAMERA, scene.pose, GROUND_DOWN_M)
        return bool(tape[int(v), int(u)])

    # The north-east corner of the unturned area is (1, 1).
    assert is_tape(1.0, 1.0)
    assert is_tape(1.0, 0.8)
    assert is_tape(0.8, 1.0)
    assert not is_tape(1.0, 1.1)
    assert not is_tape(1.1, 1.0)
    assert not is_tape(0.8, 0.8)


def test_ground_stays_where_it_is(renderer):
    one = scene_of(at=(10.0, 20.0))
    other = scene_of(at=(14.0, 13.0), attitude=(0.1, 0.15, 1.8), height_m=33.0)
    grid = np.stack(np.meshgrid(np.linspace(-2, 24, 60), np.linspace(3, 30, 60)), -1).reshape(-1, 2)
    light = []
    for scene in (one, other):
        image = cv2.GaussianBlur(renderer.render(scene), (9, 9), 2.0).astype(np.float64)
        pixels = ground_to_pixel(grid, CAMERA, scene.pose, GROUND_DOWN_M).astype(int)
        light.append(image[pixels[:, 1], pixels[:, 0]].mean(axis=-1))
    assert np.corrcoef(light)[0, 1] > 0.85


def test_same_seed_and_scene_give_the_same_picture():
    scene = scene_of(animal_at(3.0, 4.0, "zebra"))
    first, second = (Renderer(CAMERA, SEED).render(scene) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    later = Renderer(CAMERA, SEED).render(replace(scene, pose=replace(scene.pose, time_s=3.1)))
    assert 0.5 < np.abs(later.astype(int) - first).mean() < 10.0


def test_legs_move_with_the_distance_walked(renderer):
    still = scene_of(animal_at(0.0, 0.0, "panda"), height_m=8.0)
    walking = replace(still, animals=(replace(still.animals[0], walked_m=0.4),))
    change = np.abs(renderer.render(still).astype(int) - renderer.render(walking))
    assert (change.max(axis=-1) > 60).sum() > 100


@pytest.mark.parametrize("appearance", APPEARANCES)
def test_animals_are_drawn_at_their_size(renderer, appearance):
    scene = scene_of(animal_at(0.0, 0.0, appearance), height_m=10.0)
    bare = renderer.render(replace(scene, animals=())).astype(int)
    change = renderer.render(scene).astype(int) - bare
    # A shadow is the ground at half its light: what is not so, or darker, is the animal.
    is_animal = np.abs(change - bare * (change / bare).mean(-1, keepdims=True)).max(-1) > 25
    is_animal |= (change < -0.65 * bare).all(axis=-1)
    length_m, width_m, height_m = drawn_size_m(appearance)
    seen_m = max(np.ptp(pixels) for pixels in np.nonzero(is_animal))
    seen_m *= (10.0 - height_m) / CAMERA.focal_px
    assert 0.55 * length_m < seen_m < 1.15 * max(length_m, width_m)
    assert 0.5 < length_m < 13.0


@pytest.mark.parametrize("attitude", [(0.0, 1.2, 0.0), (-2.0, 0.4, 1.0), (math.pi, 0.0, 0.0)])
def test_crashing_vehicle_still_sees_something(renderer, attitude):
    animals = [animal_at(30.0 * i, 7.0 * i, name) for i, name in enumerate(APPEARANCES)]
    image = renderer.render(scene_of(*animals, attitude=attitude))
    assert image.shape == (480, 640, 3)


def test_landed_vehicle_still_sees_something(renderer):
    assert renderer.render(scene_of(animal_at(0.0, 0.0), height_m=0.0)).shape == (480, 640, 3)


async def ask(reader, writer):
    writer.write(b"SHOT")
    async with asyncio.timeout(10.0):
        word, time_s, num_bytes = struct.unpack("!4sdI", await reader.readexactly(16))
        jpeg = await reader.readexactly(num_bytes)
    assert word == b"SHOT"
    return time_s, cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)


def test_server_answers_with_the_scene_of_that_instant():
    async def check():
        captured, time_s = [], 1.0

        def scene():
            still = scene_of(animal_at(1.0, 2.0))
            return replace(still, pose=replace(still.pose, time_s=time_s))

        async with CameraServer(CAMERA, SEED, scene, captured.append) as server:
            one = await asyncio.open_connection("127.0.0.1", server.port)
            two = await asyncio.open_connection("127.0.0.1", server.port)
            first_s, image = await ask(*one)
            time_s = 2.5
            second_s, _ = await ask(*two)
            one[1].close()
            two[1].close()
        assert (first_s, second_s) == (1.0, 2.5)
        assert [s.pose.time_s for s in captured] == [1.0, 2.5]
        exact = Renderer(CAMERA, SEED).render(captured[0])
        assert np.abs(image.astype(int) - exact).mean() < 3.0

    asyncio.run(check())


def test_server_outlives_rude_clients():
    async def check():
        async with CameraServer(CAMERA, SEED, scene_of, lambda _: None) as server:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(b"what")
            assert await reader.read() == b""
            writer.close()
            _, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(b"SHOT" * 3)
            writer.transport.abort()
            polite = await asyncio.open_connection("127.0.0.1", server.port)
            assert (await ask(*polite))[1].shape == (480, 640, 3)
            polite[1].close()

    asyncio.run(check())


class SlowLens:
    """A lens of a size whose maps take long at its first picture."""

    def __init__(self):
        self.seen = []

    def as_seen(self, image):
        self.seen.append(image.shape)
        return image


def test_a_lens_is_ready_before_the_server_says_that_it_is():
    async def check():
        lens = SlowLens()
        async with CameraServer(CAMERA, SEED, scene_of, lambda _: None, lens=lens) as server:
            assert lens.seen == [(480, 640, 3)]
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            assert (await ask(reader, writer))[1].shape == (480, 640, 3)
            writer.close()
        assert lens.seen == [(480, 640, 3)] * 2

    asyncio.run(check())
