"""Pictures from a video file, which stands for any stream that OpenCV reads."""

import asyncio
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from dronemon.camera import VideoCamera
from dronemon.errors import CameraError

NUM_FRAMES = 12


@dataclass
class StillClock:
    """Stands still."""

    time_s: float = 0.0


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """A file of NUM_FRAMES pictures that get brighter by 16 each."""
    path = tmp_path_factory.mktemp("video") / "flight.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 50.0, (96, 64))
    for i in range(NUM_FRAMES):
        writer.write(np.full((64, 96, 3), 16 * i + 20, np.uint8))
    writer.release()
    return str(path)


async def capture_forever(camera):
    while True:
        await camera.capture()


def test_file_plays_in_order_with_the_clock_less_the_latency(video):
    async def check():
        clock = StillClock(50.0)
        async with VideoCamera(video, timeout_s=2.0, latency_s=0.25, clock=clock) as camera:
            pictures = [await camera.capture() for _ in range(4)]
        assert {picture.time_s for picture in pictures} == {49.75}
        assert all(picture.image.shape == (64, 96, 3) for picture in pictures)
        light = [picture.image.mean() for picture in pictures]
        assert light == sorted(light)
        assert light[-1] - light[0] >= 3 * 12

    asyncio.run(check())


def test_end_of_the_file_is_an_error_and_the_next_capture_starts_again(video):
    async def check():
        clock = StillClock()
        async with VideoCamera(video, timeout_s=2.0, latency_s=0.0, clock=clock) as camera:
            with pytest.raises(CameraError, match="ended or was silent"):
                await capture_forever(camera)
            assert (await camera.capture()).image.mean() < 60.0

    asyncio.run(check())
