"""What every FrameSource promises, checked on each of them with a real stream."""

import asyncio
import math
import time
from collections.abc import Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from dronemon.camera import FrameSource, SimulatedCamera, VideoCamera
from dronemon.errors import CameraError
from dronemon.frames import AreaFrame
from dronemon.types import CameraModel, Pose
from sim.camera import CameraServer
from sim.scene import Scene

WIDTH, HEIGHT = 96, 64
TIMEOUT_S = 1.0


class RunningClock:
    """Vehicle time that runs with the wall clock, from another start."""

    @property
    def time_s(self):
        return time.monotonic() + 1000.0


@dataclass(kw_only=True)
class Stream:
    """A running stream, to be opened as often as wanted."""

    make: Callable[[], FrameSource]
    set_silent: Callable[[bool], None]
    """The fault: the stream stays open and nothing comes."""
    oldest_s: float
    """How much older than the request a picture may be."""


async def capture_forever(source):
    """Until an error: when a stream falls silent, what was on its way may still arrive."""
    while True:
        await source.capture()


@asynccontextmanager
async def simulated(clock):
    camera = CameraModel(width_px=WIDTH, height_px=HEIGHT, horizontal_fov_rad=math.pi / 2.0)
    frame = AreaFrame(
        centre_ned_m=(0.0, 0.0),
        ground_down_m=0.0,
        side_m=200.0,
        heading_rad=0.0,
        cruise_speed_m_s=5.0,
    )

    def scene():
        pose = Pose(
            time_s=clock.time_s,
            position_ned_m=(0.0, 0.0, -30.0),
            velocity_ned_m_s=(0.0, 0.0, 0.0),
            attitude_rad=(0.0, 0.0, 0.0),
        )
        return Scene(pose=pose, frame=frame, animals=())

    async with CameraServer(camera, 10_300, scene, lambda _: None) as server:
        url = f"tcp://127.0.0.1:{server.port}"
        yield Stream(
            make=lambda: SimulatedCamera(url, TIMEOUT_S),
            set_silent=lambda is_silent: setattr(server, "silent", is_silent),
            oldest_s=0.0,
        )


@asynccontextmanager
async def motion_jpeg(clock):
    """A network camera: JPEG after JPEG over HTTP."""
    image = np.full((HEIGHT, WIDTH, 3), (30, 120, 60), np.uint8)
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    part = b"--next\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg)
    may_send = asyncio.Event()
    may_send.set()

    async def serve(reader, writer):
        try:
            await reader.readuntil(b"\r\n\r\n")
            writer.write(b"HTTP/1.0 200 OK\r\n")
            writer.write(b"Content-Type: multipart/x-mixed-replace;boundary=next\r\n\r\n")
            while True:
                await may_send.wait()
                writer.write(part + jpeg + b"\r\n")
                await writer.drain()
                await asyncio.sleep(0.02)  # the camera's frame interval
        except (ConnectionError, asyncio.IncompleteReadError):
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with server:
        url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/"
        yield Stream(
            make=lambda: VideoCamera(url, timeout_s=TIMEOUT_S, latency_s=0.1, clock=clock),
            set_silent=lambda is_silent: may_send.clear() if is_silent else may_send.set(),
            oldest_s=0.3,
        )


SOURCES = {"simulated": simulated, "motion_jpeg": motion_jpeg}


@pytest.fixture(params=SOURCES)
def run(request):
    """Runs a check(stream, clock) with one kind of source."""

    def run_check(check):
        async def main():
            clock = RunningClock()
            async with SOURCES[request.param](clock) as stream:
                await check(stream, clock)

        asyncio.run(main())

    return run_check


def test_pictures_are_fresh_and_in_order(run):
    async def check(stream, clock):
        async with stream.make() as source:
            last_s = 0.0
            for _ in range(5):
                asked_s = clock.time_s
                picture = await source.capture()
                assert picture.image.shape == (HEIGHT, WIDTH, 3)
                assert picture.image.dtype == np.uint8
                assert picture.image[HEIGHT // 2, WIDTH // 2, 1] > 40
                assert asked_s - stream.oldest_s <= picture.time_s <= clock.time_s
                assert picture.time_s >= last_s
                last_s = picture.time_s

    run(check)


def test_silent_stream_is_an_error_in_time_and_the_next_capture_recovers(run):
    async def check(stream, clock):
        async with stream.make() as source:
            await source.capture()
            stream.set_silent(True)
            asked_s = clock.time_s
            with pytest.raises(CameraError, match=r"(within|silent for) 1 s"):
                await capture_forever(source)
            assert clock.time_s - asked_s < 2.5 * TIMEOUT_S
            stream.set_silent(False)
            picture = await source.capture()
            assert clock.time_s - picture.time_s < TIMEOUT_S + stream.oldest_s

    run(check)


def test_cancelled_capture_leaves_the_source_usable(run):
    async def check(stream, clock):
        async with stream.make() as source:
            stream.set_silent(True)
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(capture_forever(source), 0.1)
            stream.set_silent(False)
            assert (await source.capture()).time_s <= clock.time_s

    run(check)


def test_two_callers_each_get_a_picture(run):
    async def check(stream, clock):
        async with stream.make() as source, asyncio.TaskGroup() as group:
            one = group.create_task(source.capture(), name="one")
            other = group.create_task(source.capture(), name="other")
        assert one.result().image.shape == other.result().image.shape

    run(check)


def test_silent_stream_cannot_be_left_open(run):
    async def check(stream, clock):
        async with stream.make() as source:
            await source.capture()
            stream.set_silent(True)
            left_s = clock.time_s
        assert clock.time_s - left_s < 3.0

    run(check)


@pytest.mark.parametrize(
    "make",
    [
        lambda: SimulatedCamera("tcp://127.0.0.1:9", 0.5),
        lambda: VideoCamera(
            "http://127.0.0.1:9/", timeout_s=0.5, latency_s=0.0, clock=RunningClock()
        ),
        lambda: VideoCamera("absent.mp4", timeout_s=0.5, latency_s=0.0, clock=RunningClock()),
    ],
)
def test_absent_camera_is_an_error_when_opened(make):
    async def check():
        with pytest.raises(CameraError, match=r"\?$"):
            async with make():
                pass

    asyncio.run(check())
