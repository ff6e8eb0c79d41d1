"""The simulated camera's client against servers that misbehave."""

import asyncio
import struct

import cv2
import numpy as np
import pytest

from dronemon.camera import SimulatedCamera
from dronemon.errors import CameraError

JPEG = cv2.imencode(".jpg", np.full((8, 8, 3), 99, np.uint8))[1].tobytes()
SIZE_AT = JPEG.index(b"\xff\xc0") + 5  # height and width in the frame header


def jpeg_that_says(width_px, height_px):
    return JPEG[:SIZE_AT] + struct.pack("!2H", height_px, width_px) + JPEG[SIZE_AT + 4 :]


def capture_from(*answers, num_captures=1):
    """Captures from a server that gives each connection one answer and hangs up."""
    left = list(answers)

    async def serve(reader, writer):
        if await reader.read(4):
            writer.write(left.pop(0))
        writer.close()

    async def check():
        results = []
        async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            async with SimulatedCamera(f"tcp://127.0.0.1:{port}", 2.0) as camera:
                for _ in range(num_captures):
                    try:
                        results.append(await camera.capture())
                    except CameraError as error:
                        results.append(error)
        return results

    return asyncio.run(check())


def answer(jpeg, time_s=7.25, word=b"SHOT", num_bytes=None):
    return struct.pack("!4sdI", word, time_s, len(jpeg) if num_bytes is None else num_bytes) + jpeg


def test_picture_carries_the_capture_time():
    (picture,) = capture_from(answer(JPEG))
    assert picture.time_s == 7.25
    assert picture.image.shape == (8, 8, 3)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (answer(JPEG, word=b"HTTP"), "another program"),
        (answer(JPEG, num_bytes=2**31), "at most"),
        (answer(b"", num_bytes=0), "at most"),
        (answer(b"no jpeg at all"), "no whole JPEG"),
        (answer(jpeg_that_says(65000, 65000)), "cannot be read"),
        (answer(jpeg_that_says(8192, 8193)), "8192 x 8193 pixels are more"),
    ],
)
def test_bad_answer_is_an_error_and_the_next_capture_recovers(bad, message):
    error, picture = capture_from(bad, answer(JPEG), num_captures=2)
    assert isinstance(error, CameraError)
    assert message in str(error)
    assert picture.time_s == 7.25


def test_answer_cut_short_is_asked_for_again():
    (picture,) = capture_from(answer(JPEG)[:40], answer(JPEG))
    assert picture.time_s == 7.25


def test_answers_cut_short_twice_are_an_error():
    error, picture = capture_from(b"", answer(JPEG)[:40], answer(JPEG), num_captures=2)
    assert "could not send a picture" in str(error)
    assert picture.time_s == 7.25


def test_capture_reconnects_by_itself_after_a_hang_up():
    first, second = capture_from(answer(JPEG), answer(JPEG, time_s=8.0), num_captures=2)
    assert (first.time_s, second.time_s) == (7.25, 8.0)
