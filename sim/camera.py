"""The simulated downward camera as a device: a TCP port that hands out pictures of the world."""

from __future__ import annotations

import asyncio
import random
import struct
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from types import MappingProxyType
from typing import Self

import cv2
import numpy as np

from dronemon.mission.schema import Simulation
from dronemon.types import CameraModel, ImageArray
from dronemon.vision.lens import Rectifier
from sim.exposure import KIND
from sim.renderer import Renderer
from sim.scene import Scene, with_faults

REQUEST = b"SHOT"
ANSWER = struct.Struct("!4sdI")
"""Header of an answer: b"SHOT", vehicle time at capture in s, bytes of JPEG that follow."""
_FULL_COLOUR_QUALITY = 90
MAX_CLIENTS = 8
SEND_TIMEOUT_S = 5.0
STOP_TIMEOUT_S = 5.0
_LATE_CHECK_S = 0.005


class CameraServer:
    """Hands out pictures over TCP on 127.0.0.1, of the scene at the instant of the request.

    A client sends REQUEST and gets ANSWER and a JPEG. `silent` leaves requests unanswered, as a
    camera does that hangs.

    faults: kinds that are active now -> value; lens: what its pictures pass through; simulation:
    says how kind light, clouds, shutter and compression are
    """

    def __init__(
        self,
        camera: CameraModel,
        seed: int,
        scene: Callable[[], Scene],
        on_capture: Callable[[Scene], None],
        faults: Mapping[str, float] = MappingProxyType({}),
        lens: Rectifier | None = None,
        simulation: Simulation = KIND,
    ) -> None:
        self.silent = False
        self._camera = camera
        self._seed = seed
        self._rng = random.Random(seed)
        self._scene = scene
        self._on_capture = on_capture
        self._faults = faults
        self._lens = lens
        self._simulation = simulation
        self._last: bytes | None = None
        self._jpeg: bytes | None = None
        self._clients: dict[asyncio.Task[None], asyncio.StreamWriter] = {}

    async def __aenter__(self) -> Self:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="camera")
        await asyncio.get_running_loop().run_in_executor(self._thread, self._get_ready)
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        return self

    def _get_ready(self) -> None:
        """Make all that the first picture needs: the maps of a lens take seconds."""
        self._renderer = Renderer(self._camera, self._seed, self._simulation)
        if self._lens is not None:
            size = self._camera.height_px, self._camera.width_px
            self._lens.as_seen(np.zeros((*size, 3), np.uint8))

    async def __aexit__(self, *exc: object) -> None:
        self._server.close()
        for writer in self._clients.values():
            writer.transport.abort()  # ends its task, which asyncio 3.11 does not like cancelled
        if self._clients:
            await asyncio.wait(list(self._clients), timeout=STOP_TIMEOUT_S)
        self._thread.shutdown(wait=False, cancel_futures=True)

    @property
    def port(self) -> int:
        """TCP port that the server listens on."""
        port: int = self._server.sockets[0].getsockname()[1]
        return port

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = asyncio.current_task()
        assert client is not None
        self._clients[client] = writer
        try:
            if len(self._clients) <= MAX_CLIENTS:
                await self._answer_requests(reader, writer)
        except (ConnectionError, TimeoutError, asyncio.IncompleteReadError):
            pass  # the client went away or stopped reading; it may connect again
        finally:
            del self._clients[client]
            writer.close()

    async def _answer_requests(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        while await reader.readexactly(len(REQUEST)) == REQUEST:
            if self.silent or "camera" in self._faults:
                continue
            if self._last is None or "repeat" not in self._faults:
                self._last = await self._capture()
            writer.write(self._last)
            async with asyncio.timeout(SEND_TIMEOUT_S):
                await writer.drain()

    async def _capture(self) -> bytes:
        """Answer with a new picture."""
        scene = self._scene()
        self._on_capture(scene)
        loop = asyncio.get_running_loop()
        shown = with_faults(scene, self._faults, self._rng)
        if self._jpeg is None or "freeze" not in self._faults:
            self._jpeg = await loop.run_in_executor(self._thread, self._photograph, shown)
        jpeg = self._jpeg
        if "torn" in self._faults:
            jpeg = jpeg[: len(jpeg) // 2]
        due_s = scene.pose.time_s + self._faults.get("late", 0.0)
        # Vehicle time is nobody's event; a reboot sets it back.
        while scene.pose.time_s <= self._scene().pose.time_s < due_s:  # noqa: ASYNC110
            await asyncio.sleep(_LATE_CHECK_S)
        time_s = scene.pose.time_s + self._faults.get("misdate", 0.0)
        return ANSWER.pack(REQUEST, time_s, len(jpeg)) + jpeg

    def _photograph(self, scene: Scene) -> bytes:
        image = self._renderer.render(scene)
        if self._lens is not None:
            image = self._lens.as_seen(image)
        shown = np.zeros_like(image) if "blank" in self._faults else image
        return encode(shown, self._simulation.jpeg_quality)


def encode(image: ImageArray, quality: int) -> bytes:
    """The picture as it goes over the wire: a JPEG; below 90 its colours have half the detail."""
    is_full = quality >= _FULL_COLOUR_QUALITY
    colours = (
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444 if is_full else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
    )
    options = (
        *(cv2.IMWRITE_JPEG_QUALITY, quality),
        *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, colours),
    )
    is_encoded, jpeg = cv2.imencode(".jpg", image, options)
    assert is_encoded
    return jpeg.tobytes()


def decode(jpeg: bytes) -> ImageArray:
    """The picture that came over the wire. -> (height, width, 3) uint8 BGR"""
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image, np.uint8)
