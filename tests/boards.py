"""Two lenses, and pictures that they take of a board held before them."""

from __future__ import annotations

import cv2
import numpy as np

from dronemon.types import ImageArray
from dronemon.vision.calibration import Board
from dronemon.vision.lens import Lens

MATRIX = np.array([[200.0, 0.0, 165.0], [0.0, 202.0, 122.0], [0.0, 0.0, 1.0]])
WIDE = Lens(
    width_px=320,
    height_px=240,
    matrix=MATRIX,
    distortion=np.array([-0.28, 0.09, 0.001, -0.0005, -0.01]),
)
FISHEYE = Lens(
    width_px=320,
    height_px=240,
    matrix=MATRIX * [[0.75], [0.75], [1.0]],
    distortion=np.array([0.02, -0.01, 0.003, -0.0005]),
    is_fisheye=True,
)
ROWS, COLUMNS = np.mgrid[:240, :320]


def photographs(lens: Lens, board: Board, count: int = 40) -> list[ImageArray]:
    """A board, held to all sides before a lens."""
    px_per_m = 4000.0
    if board.markers is None:
        size = board.columns + 1, board.rows + 1
        squares = np.add.outer(np.arange(size[1]), np.arange(size[0])) % 2 * 255
        side_px = round(board.square_m * px_per_m)
        print_ = np.kron(squares, np.ones((side_px, side_px))).astype(np.uint8)
    else:
        size = board.columns, board.rows
        pixels = tuple(round(n * board.square_m * px_per_m) for n in size)
        print_ = np.asarray(board.charuco().generateImage(pixels), np.uint8)
    print_ = cv2.copyMakeBorder(print_, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)
    middle = np.array(print_.shape[::-1]) / 2.0
    rng = np.random.default_rng(10_000)
    rays = lens.rays(np.column_stack([COLUMNS.ravel(), ROWS.ravel()]).astype(float))
    pictures = []
    for _ in range(count):
        turn, _ = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3) * [1.0, 1.0, 0.6])
        away_m = rng.uniform(0.2, 0.36)
        at_px = rng.uniform((60.0, 60.0), (260.0, 180.0))
        place = lens.rays(at_px[None])[0] * away_m
        depth = (turn[:, 2] @ place) / (rays @ turn[:, 2])
        on_board = (rays * depth[:, None] - place) @ turn
        x, y = (on_board[:, i] * px_per_m + middle[i] for i in (0, 1))
        maps = (a.reshape(240, 320).astype(np.float32) for a in (x, y))
        seen = cv2.remap(print_, *maps, cv2.INTER_AREA, borderValue=120)
        pictures.append(np.asarray(cv2.cvtColor(seen, cv2.COLOR_GRAY2BGR), np.uint8))
    return pictures
