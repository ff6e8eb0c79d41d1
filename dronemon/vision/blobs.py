"""Finds spots of one colour, or warm ones, of about the right size: a plain `Detector`.

It cannot tell one target from another, or a target from any other such spot.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from dronemon.mission.detector import DetectorSection
from dronemon.types import BoolArray, CameraModel, Detection, ImageArray, Pose
from dronemon.vision.project import ground_side_m

_MOST_SPOTS, _MOST_TRIED = 32, 2000
_MIN_AREA_PX = 9


_PIXEL = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


class BlobDetector:
    """Finds spots, which are all of the one appearance that is watched."""

    def __init__(self, of: DetectorSection, appearance: str, camera: CameraModel) -> None:
        self._of, self._appearance, self._camera = of, appearance, camera

    def detect(self, image: ImageArray, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        """The spots that are wholly in a picture, the largest first.

        image: (height, width, 3) uint8 BGR; scores say how well a spot fills its box
        """
        count, _, stats, centres = cv2.connectedComponentsWithStats(
            self._is_like(image).astype(np.uint8), connectivity=8
        )
        left, top, width, height, area = stats[1:count].T
        is_whole = (left > 0) & (top > 0)
        is_whole &= (left + width < image.shape[1]) & (top + height < image.shape[0])
        is_whole &= area >= _MIN_AREA_PX
        boxes = np.stack([left, top, left + width, top + height], axis=1).astype(float)
        found = []
        for index in np.flatnonzero(is_whole)[np.argsort(-area[is_whole])][:_MOST_TRIED]:
            centre_px = centres[1 + index] + 0.5
            m_per_px = ground_side_m(centre_px + _PIXEL, self._camera, pose, ground_down_m)
            least_m, most_m = self._of.size_m
            filled = float(area[index] / (width[index] * height[index]))
            if (
                least_m <= math.sqrt(area[index]) * m_per_px <= most_m
                and filled >= self._of.min_score
            ):
                u, v = centre_px.tolist()
                find = Detection(
                    appearance=self._appearance,
                    pixel_px=(u, v),
                    score=filled,
                    box_px=tuple(boxes[index].tolist()),
                )
                found.append(find)
        return tuple(found[:_MOST_SPOTS])

    def _is_like(self, image: ImageArray) -> BoolArray:
        """Which pixels look so. -> (height, width)"""
        hsv = cv2.cvtColor(image.astype(np.float32) / np.float32(255.0), cv2.COLOR_BGR2HSV)
        hue, saturation, brightness = np.moveaxis(hsv, -1, 0)
        is_like = (saturation >= self._of.saturation) & (brightness >= self._of.brightness)
        if self._of.hue_deg is not None:
            first, last = self._of.hue_deg
            is_like &= (hue - first) % 360.0 <= (last - first) % 360.0
        return np.asarray(is_like, np.bool_)
