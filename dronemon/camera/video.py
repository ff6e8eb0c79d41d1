"""A real camera: whatever OpenCV can read, such as an RTSP or UDP stream, a device or a file."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Self

import cv2
import numpy as np

from dronemon.clock import Clock
from dronemon.errors import CameraError
from dronemon.types import Picture

_STOP_TIMEOUT_S = 2.0


class VideoCamera:
    """Pictures of a video stream, each stamped with the clock's time on arrival less `latency_s`.

    `source` is a URL, a file or the number of a device. A thread reads the stream without pause, so
    that no old picture waits in a buffer; `capture` gives the next one that arrives. A file plays
    at its own speed.
    """

    def __init__(
        self, source: str | int, *, timeout_s: float, latency_s: float, clock: Clock
    ) -> None:
        self._source = source
        self._timeout_s = timeout_s
        self._latency_s = latency_s
        self._clock = clock
        self._reader: _Reader | None = None
        self._waiting: list[asyncio.Future[Picture]] = []

    async def __aenter__(self) -> Self:
        try:
            await self.capture()
        except BaseException:
            await self._stop()
            raise
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self._stop()

    async def capture(self) -> Picture:
        """The next picture of the stream. Raises CameraError; the next call then opens it anew."""
        loop = asyncio.get_running_loop()
        if self._reader is None:
            self._reader = self._start(loop)
        picture: asyncio.Future[Picture] = loop.create_future()
        self._waiting.append(picture)
        try:
            async with asyncio.timeout(self._timeout_s):
                return await picture
        except TimeoutError as exc:
            if self._reader is not None:
                self._reader.is_stopping.set()
                self._reader = None
            raise CameraError(
                f"no picture from {self._source!r} within {self._timeout_s:g} s; "
                "is the camera on and streaming there, or camera.timeout_s too short?"
            ) from exc
        finally:
            if picture in self._waiting:
                self._waiting.remove(picture)

    def _start(self, loop: asyncio.AbstractEventLoop) -> _Reader:
        def deliver(result: Picture | CameraError) -> None:
            loop.call_soon_threadsafe(self._arrived, reader, result)

        reader = _Reader(self._source, self._timeout_s, self._stamp_s, deliver)
        reader.start()
        return reader

    def _stamp_s(self) -> float:
        return self._clock.time_s - self._latency_s

    async def _stop(self) -> None:
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.is_stopping.set()
            await asyncio.to_thread(reader.join, _STOP_TIMEOUT_S)

    def _arrived(self, reader: _Reader, result: Picture | CameraError) -> None:
        """Hand a picture, or the end of the stream, to those who wait."""
        if reader is not self._reader:
            return
        if isinstance(result, CameraError):
            self._reader = None
        waiting, self._waiting = self._waiting, []
        for picture in waiting:
            if picture.done():
                continue
            if isinstance(result, CameraError):
                picture.set_exception(result)
            else:
                picture.set_result(result)


class _Reader(threading.Thread):
    """Reads one stream until it ends or is told to stop."""

    def __init__(
        self,
        source: str | int,
        timeout_s: float,
        stamp_s: Callable[[], float],
        deliver: Callable[[Picture | CameraError], None],
    ) -> None:
        super().__init__(name="video", daemon=True)
        self.is_stopping = threading.Event()
        self._source = source
        self._timeout_ms = int(timeout_s * 1000.0)
        self._stamp_s = stamp_s
        self._deliver = deliver

    def run(self) -> None:
        """Deliver every picture as it comes, and a CameraError at the end."""
        with suppress(RuntimeError):  # the event loop is closed: nobody listens any more
            video = open_video(self._source, self._timeout_ms)
            limit = f"{self._timeout_ms / 1000.0:g} s"
            problem = f"could not be opened within {limit}; is the address right and the camera on?"
            try:
                if video.isOpened():
                    self._read(video)
                    problem = f"ended or was silent for {limit}; is the camera still on?"
                if not self.is_stopping.is_set():
                    self._deliver(CameraError(f"the video {self._source!r} {problem}"))
            finally:
                video.release()

    def _read(self, video: cv2.VideoCapture) -> None:
        is_file = isinstance(self._source, str) and Path(self._source).is_file()
        pause_s = 1.0 / max(video.get(cv2.CAP_PROP_FPS), 1.0) if is_file else 0.0
        while not self.is_stopping.wait(pause_s):
            is_read, image = video.read()
            if not is_read:
                return
            self._deliver(Picture(time_s=self._stamp_s(), image=np.asarray(image, np.uint8)))


def open_video(source: str | int, timeout_ms: int) -> cv2.VideoCapture:
    """A device's number, or a URL or file, which is given up when it is silent for so long."""
    if isinstance(source, int):
        return cv2.VideoCapture(source)
    timeouts = (cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, cv2.CAP_PROP_READ_TIMEOUT_MSEC)
    limits = [number for timeout in timeouts for number in (timeout, timeout_ms)]
    return cv2.VideoCapture(source, cv2.CAP_FFMPEG, limits)
