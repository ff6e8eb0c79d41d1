"""The eyes of a flight behind one protocol: a picture in, the targets found in it out."""

from __future__ import annotations

from itertools import islice
from typing import Any, Protocol

import numpy as np

from dronemon.errors import CameraError, blaming
from dronemon.types import Detection, ImageArray, Pose

_MOST_FINDS = 1000


class Detector(Protocol):
    """Finds and names what a mission watches. It remembers nothing from picture to picture."""

    def detect(self, image: ImageArray, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        """What a picture shows of the targets.

        image:         (height, width, 3) uint8 BGR, of the camera's size, left as it is
        pose:          of the camera at capture: the vehicle's, on a gimbal with that one's attitude
        ground_down_m: () float64 m down of the ground, in the pose's frame

        -> any number of each appearance, in any order, with scores from 0 to 1
        """


def look(
    detector: Detector, image: ImageArray, pose: Pose, ground_down_m: float
) -> tuple[Detection, ...]:
    """What a detector finds, which may be anybody's: see `Detector.detect`.

    Raises CameraError for one that fails, or finds what cannot be.
    """
    with blaming("the detector", CameraError):
        found = tuple(islice(detector.detect(image, pose, ground_down_m), _MOST_FINDS))
        for detection in found:
            if not _can_be(detection):
                raise CameraError(
                    f"the detector gave {detection!r:.200}; it owes Detections with an appearance, "
                    "a finite pixel_px, and a score from 0 to 1"
                )
    return found


def _can_be(find: Any) -> bool:
    if not isinstance(find, Detection) or not isinstance(find.appearance, str):
        return False
    box_px = find.box_px if find.box_px is not None else (0.0,) * 4
    is_whole = len(find.pixel_px) == 2 and len(box_px) == 4
    return is_whole and bool(np.isfinite([*find.pixel_px, *box_px]).all() and 0 <= find.score <= 1)
