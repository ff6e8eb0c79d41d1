"""What was found in a picture, drawn into it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from dronemon.types import Detection, ImageArray

_OTHER_RGB = (235, 235, 235)
_HALF_PX = 12
"""Of the box around a find without one."""
_FAR_PX = 1e4
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def marked(
    image: ImageArray, found: Sequence[Detection], rgb: Mapping[str, tuple[int, int, int]]
) -> ImageArray:
    """A picture with a box and a label around each find. rgb: colours of appearances"""
    drawn = image.copy()
    for detection in found:
        (u, v), bgr = detection.pixel_px, rgb.get(detection.appearance, _OTHER_RGB)[::-1]
        box = detection.box_px or (u - _HALF_PX, v - _HALF_PX, u + _HALF_PX, v + _HALF_PX)
        left, top, right, bottom = (round(min(max(edge, -_FAR_PX), _FAR_PX)) for edge in box)
        cv2.rectangle(drawn, (left, top), (right, bottom), bgr, 2)
        label = f"{detection.appearance} {detection.score:.2f}"
        where = left, top - 5 if top > 20 else bottom + 15
        for colour, width in (((0, 0, 0), 3), (bgr, 1)):
            cv2.putText(drawn, label, where, _FONT, 0.5, colour, width, cv2.LINE_AA)
    return np.asarray(drawn, np.uint8)


def write_picture(path: Path, image: ImageArray) -> None:
    """Write a JPEG. Raises OSError."""
    is_encoded, jpeg = cv2.imencode(".jpg", image)
    assert is_encoded  # of this type and shape
    path.write_bytes(jpeg.tobytes())
