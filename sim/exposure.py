"""How a picture is taken of what there is to see: the open shutter, the light, the noise."""

from __future__ import annotations

import math

import cv2
import numpy as np

from dronemon.mission.schema import Simulation
from dronemon.types import CameraModel, FloatArray, ImageArray

KIND = Simulation()
"""Full daylight, and nothing else that blurs or spoils pictures."""
_BLUR_PX = 0.55
_NOISE_STD = 2.5
_SPARE_PX = 64
_MAX_GAIN = 16.0
"""What the sensor makes up for at most; with less light than that pictures are dark."""
_MAX_STEPS = 24


class Exposure:
    """Takes pictures as a mission's simulation says. The same seed gives the same noise."""

    def __init__(self, camera: CameraModel, seed: int, simulation: Simulation) -> None:
        gain = min(1.0 / simulation.light, _MAX_GAIN)
        self._brightness = simulation.light * gain
        shape = (camera.height_px + _SPARE_PX, camera.width_px + _SPARE_PX, 3)
        # Shot noise: a quarter of the photons have half the noise, which is amplified four times.
        noise_std = _NOISE_STD * math.sqrt(gain)
        noise = np.random.default_rng((seed, 1)).normal(128.0, noise_std, shape)
        self._noise = np.rint(np.clip(noise, 0.0, 255.0)).astype(np.uint8)

    def take(self, image: ImageArray, time_s: float) -> ImageArray:
        """The lens's slight blur, and noise that differs from one instant to the next."""
        row, column = np.random.default_rng(round(abs(time_s) * 1e6)).integers(0, _SPARE_PX, 2)
        height, width = image.shape[:2]
        noise = self._noise[row : row + height, column : column + width]
        blurred = cv2.GaussianBlur(image, (3, 3), _BLUR_PX)
        exposed = cv2.addWeighted(blurred, self._brightness, noise, 1.0, -128.0)
        return np.asarray(exposed, np.uint8)


def smear(image: ImageArray, end_from_start: FloatArray) -> ImageArray:
    """What an open shutter makes of a picture that moves meanwhile, itself at half time.

    end_from_start: (3, 3) of array indices (column, row, 1), from the shutter's opening to its end
    """
    height, width = image.shape[:2]
    corners = np.array([[[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]]])
    moved_px = np.linalg.norm(cv2.perspectiveTransform(corners, end_from_start) - corners, axis=-1)
    num_steps = min(math.ceil(float(moved_px.max())), _MAX_STEPS)
    if num_steps <= 1:
        return image
    total = np.zeros(image.shape, np.float32)
    still = np.eye(3)
    for share in (np.arange(num_steps) + 0.5) / num_steps - 0.5:
        # Between its ends the way is short enough to be straight.
        moved = still + share * (end_from_start / end_from_start[2, 2] - still)
        cv2.accumulate(
            cv2.warpPerspective(image, moved, (width, height), borderMode=cv2.BORDER_REPLICATE),
            total,
        )
    return np.asarray(np.rint(total / num_steps), np.uint8)
