"""Of each sighting, the part of the picture that shows it, as a small JPEG in the run folder.

A thread writes them; when it falls behind, or the disk takes none, crops are lost and counted.
"""

from __future__ import annotations

import re
import threading
from pathlib import Path
from typing import Self

import cv2
import numpy as np

from dronemon.events import Event, Pictured
from dronemon.mission import Mission
from dronemon.types import ImageArray
from dronemon.waiting import BoundedQueue

CROPS_FOLDER = "crops"
SIDE_PX = 96
_JPEG_QUALITY = 85
_MAX_WAITING = 64
_FINISH_S = 5.0


def crop_path(run: Path, number: int, target: int, name: str) -> Path:
    """Where a run keeps the crop of a target seen.

    number: of the measurement; target: among the mission's, from 0
    """
    slug = re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-").lower()[:40]
    return run / CROPS_FOLDER / f"{number:05d}-{target + 1}-{slug}.jpg"


class CropKeeper:
    """Keeps the crops of one flight; `with` opens and closes it.

    The folder is made with the first one.
    """

    def __init__(self, run: Path, mission: Mission) -> None:
        self._run = run
        self._names = [target.name for target in mission.targets]
        self._num_failed = 0
        self._queue = BoundedQueue[tuple[Path, ImageArray]](max_items=_MAX_WAITING)
        self._worker = threading.Thread(target=self._work, name="crops", daemon=True)

    @property
    def lost(self) -> str:
        """How many crops were not kept."""
        number = self._queue.dropped + self._num_failed
        return f"{number} crops of sightings" if number else ""

    def __enter__(self) -> Self:
        self._worker.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._queue.close(_FINISH_S)
        self._worker.join(_FINISH_S)

    def catch_up(self, timeout_s: float) -> None:
        """Wait until what it was told is written, at the latest for this time; not in flight."""
        self._queue.wait_empty(timeout_s)

    def take(self, event: Event) -> None:
        """Keep what a picture shows of the targets that were seen in it."""
        match event:
            case Pictured(number=number, picture=picture):
                for found, target in zip(event.detections, event.owners, strict=True):
                    if target >= 0:
                        path = crop_path(self._run, number, target, self._names[target])
                        self._queue.put((path, _around(picture.image, found.pixel_px)))

    def _work(self) -> None:
        for path, image in self._queue:
            try:
                path.parent.mkdir(exist_ok=True)
                jpeg = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))[1]
                path.write_bytes(jpeg.tobytes())
            except (OSError, cv2.error):
                self._num_failed += 1


def _around(image: ImageArray, pixel_px: tuple[float, float]) -> ImageArray:
    """The square about a pixel, smaller at the picture's border."""
    (column, row), half = (round(x) for x in pixel_px), SIDE_PX // 2
    rows, columns = (slice(max(0, at - half), max(1, at + half)) for at in (row, column))
    return np.ascontiguousarray(image[rows, columns])
