"""A lens, measured from pictures of a board whose corners are known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dronemon.errors import CameraError, OptionError
from dronemon.types import FloatArray, ImageArray
from dronemon.vision.lens import Lens
from dronemon.vision.markers import dictionary_of

_LEAST_CORNERS = 8
_MOST_OFF_PX = 1.0
"""By which a corner may be off after its way through the lens and back."""
_MARKER_SHARE = 0.75
"""Side of a marker over that of its square."""
Points = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """What was photographed.

    columns, rows: inner corners of a chessboard; squares of one with markers
    square_m:      side of a square
    markers:       OpenCV's dictionary of the markers in the white squares; None for a chessboard
    """

    columns: int
    rows: int
    square_m: float
    markers: str | None = None

    def __post_init__(self) -> None:
        """Raises OptionError for markers that there are not, and for a size that is none."""
        if not 0.0 < self.square_m < math.inf:
            raise OptionError(f"a square's side is {self.square_m} m; it must be above 0")
        if self.markers is not None:
            dictionary_of(self.markers)

    def find(self, image: ImageArray) -> tuple[Points, Points] | None:
        """Its corners on the board, (K, 3) m, and in the picture, (K, 2) px, if it is seen."""
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        if self.markers is not None:
            return self._find_marked(grey)
        is_found, corners = cv2.findChessboardCornersSB(grey, (self.columns, self.rows))
        if not is_found:
            return None
        places = np.zeros((self.columns * self.rows, 3), np.float32)
        places[:, :2] = np.mgrid[: self.columns, : self.rows].T.reshape(-1, 2) * self.square_m
        return places, np.asarray(corners, np.float32).reshape(-1, 2)

    def charuco(self) -> cv2.aruco.CharucoBoard:
        """The board with markers as OpenCV has it."""
        assert self.markers is not None
        size, side_m = (self.columns, self.rows), _MARKER_SHARE * self.square_m
        return cv2.aruco.CharucoBoard(size, self.square_m, side_m, dictionary_of(self.markers))

    def _find_marked(self, grey: cv2.typing.MatLike) -> tuple[Points, Points] | None:
        board = self.charuco()
        corners, numbers, *_ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        if numbers is None or len(numbers) < _LEAST_CORNERS:
            return None
        places = np.asarray(board.getChessboardCorners(), np.float32)[numbers.ravel()]
        return places, np.asarray(corners, np.float32).reshape(-1, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrated:
    """A lens and how well it explains what was seen.

    error_px: root of the mean squared distance of corners; share: of the picture's width and height
    in which the board was seen
    """

    lens: Lens
    error_px: float
    share: float


def calibrate(
    seen: Sequence[tuple[Points, Points]], size_px: tuple[int, int], *, is_fisheye: bool
) -> Calibrated:
    """Fit a lens to a board's corners in some pictures. Raises CameraError where none fits."""
    width, height = size_px
    try:
        if is_fisheye:
            places = [p.reshape(1, -1, 3).astype(np.float64) for p, _ in seen]
            corners = [c.reshape(1, -1, 2).astype(np.float64) for _, c in seen]
            flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
            fit = cv2.fisheye.calibrate(
                places, corners, size_px, np.eye(3), np.zeros(4), flags=flags
            )
        else:
            fit = cv2.calibrateCamera(
                [p for p, _ in seen], [c for _, c in seen], size_px, np.eye(3), np.zeros(5)
            )
    except cv2.error as exc:
        raise CameraError(f"no lens explains these pictures: {exc.err}") from exc
    error_px, matrix, distortion = float(fit[0]), np.asarray(fit[1]), np.asarray(fit[2]).ravel()
    lens = Lens(
        width_px=width,
        height_px=height,
        matrix=np.asarray(matrix, np.float64),
        distortion=np.asarray(distortion, np.float64),
        is_fisheye=is_fisheye,
    )
    corners_px = np.concatenate([c for _, c in seen]).astype(np.float64)
    back_px = lens.pixels(lens.rays(corners_px))
    is_sane = 0.1 * width < matrix[0, 0] < 20.0 * width and np.isfinite(distortion).all()
    if not (is_sane and np.abs(back_px - corners_px).max() < _MOST_OFF_PX):
        raise CameraError(
            "these pictures do not tell the lens: no sensible one explains them; tilt the board to "
            "all sides, and hold it into the corners"
        )
    return Calibrated(lens=lens, error_px=error_px, share=_share(seen, size_px))


def _share(seen: Sequence[tuple[Points, Points]], size_px: tuple[int, int]) -> float:
    corners: FloatArray = np.concatenate([c for _, c in seen]).astype(np.float64)
    return float((np.ptp(corners, axis=0) / size_px).min())
