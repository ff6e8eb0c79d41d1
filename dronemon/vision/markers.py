"""Finds AprilTag or ArUco markers on what is watched, such as ground robots; a `Detector`."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from dronemon.errors import OptionError, did_you_mean
from dronemon.mission.detector import DetectorSection
from dronemon.types import CameraModel, Detection, FloatArray, ImageArray, Pose
from dronemon.vision.project import ground_side_m

_MOST_OFF = 1.5
"""How much larger or smaller than it is a marker may seem: it may lie higher than the ground."""
_PX_PER_MODULE = 2.5
_PREFIX = "DICT_"
FAMILIES = tuple(
    sorted({name[len(_PREFIX) :].lower() for name in dir(cv2.aruco) if name.startswith(_PREFIX)})
)
"""Sets of markers, by OpenCV's names."""


def dictionary_of(family: str) -> cv2.aruco.Dictionary:
    """The markers of a set. Raises OptionError."""
    if family not in FAMILIES:
        raise OptionError(
            f"family {family!r}: there is no such set of markers; "
            f"{did_you_mean(family, FAMILIES)}there are: {', '.join(FAMILIES)}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _PREFIX + family.upper()))


def px_per_m_of_marker(family: str, side_m: float) -> float:
    """The detail that markers need to be found. Raises OptionError."""
    return _PX_PER_MODULE * modules_of(dictionary_of(family)) / side_m


def modules_of(dictionary: cv2.aruco.Dictionary) -> int:
    """Squares along a marker's side, its black border with them."""
    return dictionary.markerSize + 2


def number_of(appearance: str, family: str) -> int:
    """The number of a marker of a set. Raises OptionError."""
    count = len(dictionary_of(family).bytesList)
    if appearance not in map(str, range(count)):
        raise OptionError(
            f"appearance {appearance!r} is no marker of {family}; give each target the "
            f"number of its marker, 0 to {count - 1}"
        )
    return int(appearance)


class MarkerDetector:
    """Finds the markers whose numbers the targets' appearances are."""

    def __init__(self, of: DetectorSection, numbers: Sequence[str], camera: CameraModel) -> None:
        """Raises OptionError for a family or a marker that there is not."""
        self._appearances = {number_of(number, of.family): number for number in numbers}
        self._camera, self._side_m = camera, of.side_m
        self._finder = cv2.aruco.ArucoDetector(dictionary_of(of.family))

    def detect(self, image: ImageArray, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        """The targets' markers in a picture; a marker is never unsure.

        image: (height, width, 3) uint8 BGR
        """
        corners, numbers, _ = self._finder.detectMarkers(image)
        found = []
        for quad, number in zip(corners, () if numbers is None else numbers.ravel(), strict=True):
            corners_px = np.asarray(quad, np.float64).reshape(4, 2) + 0.5
            appearance = self._appearances.get(int(number))
            if appearance is not None and self._has_size(corners_px, pose, ground_down_m):
                u, v = corners_px.mean(axis=0).tolist()
                (left, top), (right, bottom) = corners_px.min(axis=0), corners_px.max(axis=0)
                found.append(
                    Detection(
                        appearance=appearance,
                        pixel_px=(u, v),
                        score=1.0,
                        box_px=(float(left), float(top), float(right), float(bottom)),
                    )
                )
        return tuple(found)

    def _has_size(self, corners_px: FloatArray, pose: Pose, ground_down_m: float) -> bool:
        """Whether a marker would be about as large as it is, if it lay on the ground."""
        if self._side_m is None:
            return True
        seems_m = ground_side_m(corners_px, self._camera, pose, ground_down_m)
        return 1.0 / _MOST_OFF < seems_m / self._side_m < _MOST_OFF
