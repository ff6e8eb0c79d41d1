"""The simulated camera's pictures, asked for one by one over TCP.

A request is the four bytes `SHOT`. The answer is the same four bytes, the vehicle time at capture
as a double, the number of bytes that follow as an unsigned 32-bit integer, both big-endian, and a
JPEG.
"""

from __future__ import annotations

import asyncio
import io
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Self
from urllib.parse import urlsplit

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from dronemon.errors import CameraError
from dronemon.types import Picture

_REQUEST = b"SHOT"
_ANSWER = struct.Struct("!4sdI")
_MAX_JPEG_BYTES = 64 * 2**20
_MAX_PIXELS = 8192**2
"""What the largest picture of a mission has; a small JPEG may unfold into gigabytes."""
_JPEG_END = b"\xff\xd9"
_CLOSE_TIMEOUT_S = 1.0


class SimulatedCamera:
    """Pictures from `python -m sim` at `url`, tcp://HOST:PORT; each may take `timeout_s`."""

    def __init__(self, url: str, timeout_s: float) -> None:
        self._url = url
        parts = urlsplit(url)
        self._address = parts.hostname, parts.port
        self._timeout_s = timeout_s
        self._turn = asyncio.Lock()
        self._stream: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def __aenter__(self) -> Self:
        async with self._limited("connect"):
            self._stream = await asyncio.open_connection(*self._address)
        return self

    async def __aexit__(self, *exc: object) -> None:
        if self._stream is not None:
            _, writer = self._stream
            self._stream = None
            writer.close()
            with suppress(OSError, TimeoutError):
                async with asyncio.timeout(_CLOSE_TIMEOUT_S):
                    await writer.wait_closed()

    async def capture(self) -> Picture:
        """The world at the instant at which the camera gets the request. Raises CameraError."""
        async with self._limited("send a picture"), self._turn:
            time_s, jpeg = await self._ask()
            try:
                image = await asyncio.to_thread(_decoded, jpeg)
            except (OSError, cv2.error) as exc:
                raise CameraError(f"{self._url} sent a picture that cannot be read: {exc}") from exc
        if image is None or bytes(jpeg[-2:]) != _JPEG_END:  # OpenCV fills what is missing with grey
            raise CameraError(f"{self._url} sent {jpeg.size} bytes that are no whole JPEG")
        return Picture(time_s=time_s, image=np.asarray(image, np.uint8))

    async def _ask(self) -> tuple[float, NDArray[np.uint8]]:
        """Capture time and JPEG of one picture."""
        stream, self._stream = self._stream, None
        if stream is not None:
            with suppress(OSError, asyncio.IncompleteReadError):  # dropped while it was idle
                return await self._ask_over(*stream)
        return await self._ask_over(*await asyncio.open_connection(*self._address))

    async def _ask_over(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> tuple[float, NDArray[np.uint8]]:
        """The same over one connection, which is kept only if the whole answer came."""
        try:
            writer.write(_REQUEST)
            await writer.drain()
            word, time_s, num_bytes = _ANSWER.unpack(await reader.readexactly(_ANSWER.size))
            if word != _REQUEST or not 0 < num_bytes <= _MAX_JPEG_BYTES:
                raise CameraError(
                    f"{self._url} answered {word!r} and {num_bytes} bytes; expected {_REQUEST!r} "
                    f"and at most {_MAX_JPEG_BYTES}; is another program listening there?"
                )
            jpeg = np.frombuffer(await reader.readexactly(num_bytes), np.uint8)
            self._stream = reader, writer
        finally:
            if self._stream is None:
                writer.close()
        return time_s, jpeg

    @asynccontextmanager
    async def _limited(self, deed: str) -> AsyncIterator[None]:
        """Time limit of one deed, and the errors of the connection in the mission's words."""
        try:
            async with asyncio.timeout(self._timeout_s):
                yield
        except TimeoutError as exc:
            raise CameraError(
                f"the camera at {self._url} did not {deed} within {self._timeout_s:g} s; "
                "is the simulator still running, or camera.timeout_s too short?"
            ) from exc
        except (OSError, asyncio.IncompleteReadError) as exc:
            raise CameraError(
                f"the camera at {self._url} could not {deed}: {exc}; is the simulator running?"
            ) from exc


def _decoded(jpeg: NDArray[np.uint8]) -> MatLike | None:
    """The picture; None if it is none. Raises OSError if its header says that it is too large."""
    try:
        width_px, height_px = Image.open(io.BytesIO(jpeg.tobytes()), formats=["JPEG"]).size
    except UnidentifiedImageError:
        return None
    except Image.DecompressionBombError as exc:
        raise OSError(str(exc)) from exc
    if width_px * height_px > _MAX_PIXELS:
        raise OSError(f"{width_px} x {height_px} pixels are more than any mission has")
    return cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
