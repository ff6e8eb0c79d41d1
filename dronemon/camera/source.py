"""What every camera offers: a picture taken as close to now as it can."""

from __future__ import annotations

import math
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from dronemon.errors import CameraError
from dronemon.types import CameraModel, FloatArray, ImageArray, Picture, Pose

_MAX_AHEAD_S = 5.0
"""Vehicle time by which the newest pose may be behind a picture on its way."""
_MIN_CONTRAST = 8
"""Least spread of a picture's values, 0 to 255: noise alone has more."""
_LEAST_TEXTURE = 0.25
"""Change by a shift below which a part of a picture, such as a black corner, says nothing."""
_MOVED_M = 1.0
"""Way after which a picture shows something else."""
_SHIFT_PX, _FROZEN = 4, 0.2
"""Shift of every fourth pixel, and share of what it changes that shows a frozen picture."""


class FrameSource(Protocol):
    """A stream of pictures with their capture times. It is open inside its `async with`."""

    async def __aenter__(self) -> Self:
        """Open the stream. Raises CameraError if it cannot be opened in time."""

    async def __aexit__(self, *exc: object) -> None:
        """Close the stream."""

    async def capture(self) -> Picture:
        """A picture taken as close to now as the source can.

        Raises CameraError when none came in time or the stream was lost. The next call tries again,
        with a new connection where that helps.
        """


def check_picture(picture: Picture, model: CameraModel, now_s: float, last_s: float) -> None:
    """See whether a picture can say anything. Raises CameraError if not.

    now_s, last_s: vehicle time, and that of the picture before
    """
    check_size(picture.image, model)
    if not picture.time_s <= now_s + _MAX_AHEAD_S:
        raise CameraError(
            f"a picture is stamped {picture.time_s:.2f} s, the vehicle's time is {now_s:.2f} s; "
            "does the camera use the vehicle's clock?"
        )
    if picture.time_s <= last_s:
        raise CameraError(f"a picture of {picture.time_s:.2f} s came again; does the camera hang?")
    check_shows(picture.image)


def check_shows(image: ImageArray) -> None:
    """See whether a picture shows anything. Raises CameraError if not."""
    sample = image[::8, ::8]
    if int(sample.max()) - int(sample.min()) < _MIN_CONTRAST:
        raise CameraError("a picture shows nothing at all; is the camera covered or broken?")


class Freshness:
    """Whether each picture shows another view than the one before.

    Only a vehicle that moves tells. A frozen view that is encoded anew differs a little, so what
    counts is how much less than one that is shifted.
    """

    def __init__(self) -> None:
        self._last: tuple[Picture, Pose] | None = None
        self._is_frozen = False

    def check(self, picture: Picture, pose: Pose) -> None:
        """Take the next picture. Raises CameraError if it shows the same as the last, elsewhere."""
        last = self._last
        if last is None:
            self._last = picture, pose
            return
        if (
            math.dist(pose.position_ned_m, last[1].position_ned_m) < _MOVED_M
            and not self._is_frozen
        ):
            return
        self._last = picture, pose
        self._is_frozen = _is_same(picture.image, last[0].image)
        if self._is_frozen:
            raise CameraError("a picture shows the same as the last one, elsewhere; is it frozen?")


def _is_same(image: ImageArray, last: ImageArray) -> bool:
    """Whether most parts of two pictures are alike: what is written over one always is."""
    green = 1  # the channel that an encoding changes least
    now, then = (i[::4, ::4, green].astype(np.int16) for i in (image, last))
    changes = _parts(np.abs(now - then)[:, _SHIFT_PX:])
    textures = _parts(np.abs(now[:, _SHIFT_PX:] - now[:, :-_SHIFT_PX]))
    told = textures > _LEAST_TEXTURE
    return bool(told.any() and np.median(changes[told] / textures[told]) < _FROZEN)


def _parts(values: NDArray[np.int16]) -> FloatArray:
    """Means of 4 x 4 parts."""
    rows = np.array_split(values, 4)
    return np.array([part.mean() for row in rows for part in np.array_split(row, 4, axis=1)])


def check_size(image: ImageArray, model: CameraModel) -> None:
    """See whether a picture is as large as the camera's. Raises CameraError if not."""
    height_px, width_px = image.shape[:2]
    check_size_px(width_px, height_px, model)


def check_size_px(width_px: int, height_px: int, model: CameraModel) -> None:
    """The same of a picture of this size."""
    wanted_px = model.width_px, model.height_px
    if (width_px, height_px) != wanted_px:
        turned = "; it seems to be turned" if (height_px, width_px) == wanted_px else ""
        raise CameraError(
            f"the camera's pictures are {width_px} x {height_px} pixels, the mission says "
            f"{model.width_px} x {model.height_px}{turned}; "
            "set camera.width_px and camera.height_px to what it sends"
        )
