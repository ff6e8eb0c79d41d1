"""Finds AprilTag or ArUco markers on what is watched, such as ground robots; a `Detector`."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence

import cv2
import numpy as np

from dronemon.errors import CameraError
from dronemon.frames import pixel_to_ground
from dronemon.types import CameraModel, Detection, FloatArray, ImageArray, Pose
from dronemon.vision.detector import check_size

_MOST_OFF = 1.5
"""How much larger or smaller than it is a marker may seem: it may lie higher than the ground."""
_PREFIX = "DICT_"
FAMILIES: tuple[str, ...] = tuple(
    sorted(name[len(_PREFIX) :].lower() for name in dir(cv2.aruco) if name.startswith(_PREFIX))
)
"""Sets of markers, by OpenCV's names."""


class MarkerDetector:
    """Finds the markers whose numbers the targets' appearances are."""

    def __init__(
        self, numbers: Sequence[str], camera: CameraModel, *, family: str, side_m: float | None
    ) -> None:
        """family: one of FAMILIES; side_m: of a marker's black square, unchecked for None.

        Raises CameraError for a family that there is not, or a target whose appearance is no number
        of it.
        """
        if family not in FAMILIES:
            near = difflib.get_close_matches(family, FAMILIES, n=1)
            raise CameraError(
                f"there is no set of markers {family!r}; "
                f"{''.join(f'did you mean {name}? ' for name in near)}"
                f"there are: {', '.join(FAMILIES)}"
            )
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, _PREFIX + family.upper()))
        count = len(dictionary.bytesList)
        for number in numbers:
            if not (number.isascii() and number.isdigit() and int(number) < count):
                raise CameraError(
                    f"appearance {number!r} is no marker of {family}; give each target the number "
                    f"of its marker, 0 to {count - 1}"
                )
        self._appearances = {int(number): number for number in numbers}
        self._camera, self._side_m = camera, side_m
        self._finder = cv2.aruco.ArucoDetector(dictionary)

    def detect(self, image: ImageArray, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        """The targets' markers in a picture; a marker is never unsure.

        image: (height, width, 3) uint8 BGR
        Raises CameraError if the picture's size is not the camera's.
        """
        check_size(image, self._camera)
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
        ground_m = pixel_to_ground(corners_px, self._camera, pose, ground_down_m)
        area_m2 = cv2.contourArea((ground_m - ground_m[0]).astype(np.float32))
        return 1.0 / _MOST_OFF < math.sqrt(area_m2) / self._side_m < _MOST_OFF
