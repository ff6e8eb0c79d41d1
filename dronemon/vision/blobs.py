"""Finds spots of one colour, or warm ones, of about the right size: a plain `Detector`.

It cannot tell one target from another, or a target from any other such spot.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from dronemon.frames import pixel_to_ground
from dronemon.types import BoolArray, CameraModel, Detection, FloatArray, ImageArray, Pose
from dronemon.vision.detector import check_size

_MOST_SPOTS = 32
_MIN_AREA_PX = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """What spots look like.

    hue_deg:    from one hue round to another, 0 red, 120 green, 240 blue; any colour for None
    saturation: least, 0 to 1
    brightness: least, 0 to 1; a thermal camera's warmth
    size_m:     least and greatest size on the ground: the root of its area
    min_score:  share of its outline that a spot fills at least
    """

    hue_deg: tuple[float, float] | None = None
    saturation: float = 0.0
    brightness: float = 0.0
    size_m: tuple[float, float] = (0.2, 5.0)
    min_score: float = 0.0


class BlobDetector:
    """Finds spots, which are all of the one appearance that is watched."""

    def __init__(self, appearance: str, camera: CameraModel, look: Look) -> None:
        self._appearance, self._camera, self._look = appearance, camera, look

    def detect(self, image: ImageArray, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        """The spots that are wholly in a picture, the largest first.

        image: (height, width, 3) uint8 BGR; scores say how well a spot fills its outline
        Raises CameraError if the picture's size is not the camera's.
        """
        check_size(image, self._camera)
        count, _, stats, centres = cv2.connectedComponentsWithStats(
            self._is_like(image).astype(np.uint8), connectivity=8
        )
        left, top, width, height, area = stats[1:count].T
        is_whole = (left > 0) & (top > 0)
        is_whole &= (left + width < image.shape[1]) & (top + height < image.shape[0])
        chosen = np.flatnonzero(is_whole & (area >= _MIN_AREA_PX))
        found = []
        for index in chosen[np.argsort(-area[chosen])]:
            centre_px = centres[1 + index] + 0.5
            size_m = float(np.sqrt(area[index])) * self._m_per_px(centre_px, pose, ground_down_m)
            filled = min(1.0, float(area[index] / (width[index] * height[index])))
            least_m, most_m = self._look.size_m
            if least_m <= size_m <= most_m and filled >= self._look.min_score:
                u, v = centre_px.tolist()
                x, y = float(left[index]), float(top[index])
                found.append(
                    Detection(
                        appearance=self._appearance,
                        pixel_px=(u, v),
                        score=filled,
                        box_px=(x, y, x + float(width[index]), y + float(height[index])),
                    )
                )
        return tuple(found[:_MOST_SPOTS])

    def _is_like(self, image: ImageArray) -> BoolArray:
        """Which pixels look so. -> (height, width)"""
        hsv = cv2.cvtColor(image.astype(np.float32) / np.float32(255.0), cv2.COLOR_BGR2HSV)
        hue, saturation, brightness = np.moveaxis(hsv, -1, 0)
        is_like = (saturation >= self._look.saturation) & (brightness >= self._look.brightness)
        if self._look.hue_deg is not None:
            first, last = self._look.hue_deg
            is_like &= (hue - first) % 360.0 <= (last - first) % 360.0
        return np.asarray(is_like, np.bool_)

    def _m_per_px(self, centre_px: FloatArray, pose: Pose, ground_down_m: float) -> float:
        """Side on the ground of a pixel there; infinite towards the horizon."""
        corners_px = centre_px + np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        (x0, y0), *rest = pixel_to_ground(corners_px, self._camera, pose, ground_down_m).tolist()
        outline = np.array([[0.0, 0.0], *([x - x0, y - y0] for x, y in rest)], np.float32)
        return float(np.sqrt(cv2.contourArea(outline))) if np.isfinite(outline).all() else np.inf
