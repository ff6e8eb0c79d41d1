"""Malformed answers of a camera: each is the camera's error, and the next picture still comes."""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
import struct

import cv2
import numpy as np
import pytest

from dronemon.camera import SimulatedCamera, check_picture
from dronemon.errors import CameraError
from dronemon.types import CameraModel, Picture

NUM_ANSWERS = 300
MODEL = CameraModel(width_px=64, height_px=48, horizontal_fov_rad=1.0)
NOISE = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)


def _whole_answer(time_s: float) -> bytes:
    jpeg = cv2.imencode(".jpg", NOISE)[1].tobytes()
    return struct.pack("!4sdI", b"SHOT", time_s, len(jpeg)) + jpeg


def _spoilt(rng: random.Random) -> bytes:
    """An answer with a few bytes changed, cut off, or put in."""
    answer = bytearray(_whole_answer(1.0))
    for _ in range(rng.randint(1, 4)):
        place = rng.randrange(20) if rng.random() < 0.5 else rng.randrange(len(answer))
        answer[place : place + rng.randint(0, 2)] = rng.randbytes(rng.randint(0, 2))
    return bytes(answer[: rng.choice([None, None, 10, len(answer) - 1])])


def test_spoilt_answers_are_errors_and_end_nothing():
    async def check() -> None:
        rng, answers = random.Random(1), iter(())

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
                while await reader.readexactly(4):
                    answer = next(answers)
                    writer.write(answer)
                    if answer is not whole:
                        writer.write_eof()
            writer.close()

        whole = _whole_answer(2.0)
        answers = iter([x for _ in range(NUM_ANSWERS) for x in (_spoilt(rng), whole)] * 2)
        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        num_whole = 0
        async with server, SimulatedCamera(f"tcp://127.0.0.1:{port}", timeout_s=2.0) as camera:
            for _ in range(NUM_ANSWERS):
                with contextlib.suppress(CameraError):
                    picture = await camera.capture()
                    assert picture.image.dtype == np.uint8
                    num_whole += picture.time_s == 2.0
        assert num_whole > NUM_ANSWERS / 10

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
