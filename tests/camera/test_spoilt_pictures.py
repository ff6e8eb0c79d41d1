"""Malformed answers of a camera: each is the camera's error, and the next pictures still come."""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.camera import Freshness, RectifiedCamera, SimulatedCamera, check_picture
from dronemon.errors import CameraError
from dronemon.types import CameraModel, ImageArray, Picture, Pose

MODEL = CameraModel(width_px=64, height_px=48, horizontal_fov_rad=1.0)
NOISE = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)


def _whole_answer(time_s: float) -> bytes:
    jpeg = cv2.imencode(".jpg", NOISE)[1].tobytes()
    return struct.pack("!4sdI", b"SHOT", time_s, len(jpeg)) + jpeg


def _changed(place: int, num_bytes: int, new: bytes) -> bytes:
    """A whole answer with bytes changed, left out or put in."""
    answer = _whole_answer(1.0)
    return answer[:place] + new + answer[place + num_bytes :]


HEADERS = st.builds(
    struct.Struct("!4sdI").pack,
    st.just(b"SHOT") | st.binary(min_size=4, max_size=4),
    st.floats(),
    st.integers(0, 100) | st.integers(0, 2**32 - 1),
)
PLACES = st.integers(0, 20) | st.integers(0, len(_whole_answer(1.0)))
SPOILT = st.one_of(
    st.builds(_changed, PLACES, st.integers(0, 4), st.binary(max_size=4)),
    st.builds(lambda length: _whole_answer(1.0)[:length], PLACES),
    st.builds(bytes.__add__, HEADERS, st.binary(max_size=100)),
    st.binary(max_size=100),
)


@pytest.mark.lengthy
@settings(max_examples=60)
@given(st.lists(SPOILT, min_size=5, max_size=5))
def test_spoilt_answers_are_errors_and_end_nothing(batch: list[bytes]):
    answers: list[bytes] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
            await reader.readexactly(4)
            writer.write(answers.pop() if answers else _whole_answer(2.0))
        writer.close()

    async def check() -> None:
        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        async with server, SimulatedCamera(f"tcp://127.0.0.1:{port}", timeout_s=5.0) as camera:
            for spoilt in batch:
                answers.append(spoilt)
                for _ in range(2):  # what comes after its end spoils one more
                    with contextlib.suppress(CameraError):
                        assert (await camera.capture()).image.dtype == np.uint8
                assert (await camera.capture()).time_s == 2.0

    asyncio.run(check())


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (Picture(time_s=math.nan, image=NOISE), "stamped nan"),
        (Picture(time_s=math.inf, image=NOISE), "stamped inf"),
        (Picture(time_s=1000.0, image=NOISE), "vehicle's clock"),
        (Picture(time_s=9.0, image=NOISE), "came again"),
        (Picture(time_s=10.0, image=np.zeros_like(NOISE)), "nothing at all"),
        (Picture(time_s=10.0, image=NOISE[:, :48]), "48 x 48 pixels"),
        (Picture(time_s=10.0, image=np.swapaxes(NOISE, 0, 1)), "turned"),
    ],
)
def test_pictures_that_say_nothing_are_refused(picture: Picture, words: str):
    with pytest.raises(CameraError, match=words):
        check_picture(picture, MODEL, now_s=10.0, last_s=9.0)


def _seen_from(north_m: float) -> Pose:
    return replace(Pose.level(40.0), position_ned_m=(north_m, 0.0, -40.0))


@pytest.mark.parametrize("quality", [None, 60, 90])
def test_a_view_that_comes_again_elsewhere_is_refused_also_encoded_anew(quality: int | None):
    ground = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(300, 300, 3)), (0, 0), 3.0)
    ground = (128.0 + 200.0 * ground).clip(0, 255).astype(np.uint8)
    first, again, next_one = ground[:240], ground[:240], ground[10:250]
    if quality is not None:
        encoded = cv2.imencode(".jpg", again, (cv2.IMWRITE_JPEG_QUALITY, quality))[1]
        again = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), np.uint8)
    there, elsewhere = _seen_from(0.0), _seen_from(6.0)
    for image, pose in ((next_one, elsewhere), (again, _seen_from(0.3))):
        freshness = Freshness()
        freshness.check(Picture(time_s=1.0, image=first), there)
        freshness.check(Picture(time_s=2.0, image=image), pose)
    freshness = Freshness()
    freshness.check(Picture(time_s=1.0, image=first), there)
    for time_s in (2.0, 3.0):  # the second time where it is already
        with pytest.raises(CameraError, match="is it frozen"):
            freshness.check(Picture(time_s=time_s, image=again), elsewhere)
    freshness.check(Picture(time_s=4.0, image=next_one), elsewhere)


def test_what_is_written_over_a_view_or_hides_its_corners_freezes_nothing():
    """Flat ground seldom changes by more than the text that a camera writes over it."""
    rng = np.random.default_rng(1)
    ground = (128.0 + cv2.GaussianBlur(rng.normal(0.0, 8.0, (300, 300, 3)), (0, 0), 3.0)).round()
    freshness = Freshness()
    for step in range(5):
        view = ground[10 * step : 10 * step + 240].astype(np.uint8)
        cv2.putText(view, "REC 12:00", (10, 40), cv2.FONT_HERSHEY_SIMPLEX, 1.2, (255, 255, 255), 3)
        view[200:, :60] = 0
        freshness.check(Picture(time_s=float(step), image=view), _seen_from(6.0 * step))


def test_a_view_that_freezes_while_the_drone_creeps_is_told():
    freshness, image = Freshness(), np.repeat(NOISE, 4, axis=0).repeat(4, axis=1)
    freshness.check(Picture(time_s=0.0, image=image), _seen_from(0.0))
    freshness.check(Picture(time_s=1.0, image=image), _seen_from(0.9))
    with pytest.raises(CameraError, match="is it frozen"):
        freshness.check(Picture(time_s=2.0, image=image), _seen_from(1.8))


def test_a_covered_lens_has_no_contrast_for_its_black_corners():
    class Covered:
        async def __aenter__(self) -> Covered:
            return self

        async def __aexit__(self, *_: object) -> None:
            pass

        async def capture(self) -> Picture:
            return Picture(time_s=1.0, image=np.full((48, 64, 3), 60, np.uint8))

    def with_corner(image: ImageArray) -> ImageArray:
        image = image.copy()
        image[:8, :8] = 0
        return image

    async def story() -> None:
        async with RectifiedCamera(Covered(), with_corner, MODEL) as camera:
            await camera.capture()

    with pytest.raises(CameraError, match="nothing at all"):
        asyncio.run(story())
