"""`dronemon calibrate intrinsics`: what a mission has to say of a camera's lens, measured."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from dronemon.camera.pictures import pictures_of
from dronemon.detecting import EveryOption
from dronemon.errors import CameraError, OptionError, writing
from dronemon.terminal import console, print_path
from dronemon.vision.calibration import Board, Calibrated, Points, calibrate

_LEAST_PICTURES = 8
_GOOD_ERROR_PX = 1.0
_GOOD_SHARE = 0.6
"""Share of the picture's width and height in which the board was seen."""

PicturesArgument = Annotated[
    str, typer.Argument(help="A folder of pictures of the board, or a video of it.")
]
BoardOption = Annotated[
    str,
    typer.Option(help="Inner corners of a chessboard, as in 9x6; of one with markers its squares."),
]
SquareOption = Annotated[float, typer.Option(min=0.001, max=10.0, help="Side of a square in m.")]
MarkersOption = Annotated[
    str | None, typer.Option(help="ChArUco: the markers' family, such as 4x4_50.")
]
LensOption = Annotated[Path, typer.Option(help="File to write, for camera.calibration.")]
FisheyeOption = Annotated[
    bool, typer.Option("--fisheye", help="For lenses that see more than about 120 degrees.")
]


def intrinsics_command(
    pictures: PicturesArgument,
    board: BoardOption = "9x6",
    square_m: SquareOption = 0.025,
    markers: MarkersOption = None,
    out: LensOption = Path("camera.yaml"),
    fisheye: FisheyeOption = False,
    every: EveryOption = 1,
) -> None:
    """Measure a lens from pictures of a chessboard, or of one with markers (ChArUco).

    Hold the board flat, near and far, tilted to all sides, and into every corner of the picture.
    """
    columns, rows = _size(board)
    if out.exists():
        raise OptionError(f"--out {out}: is there already; name another file")
    wanted = Board(columns=columns, rows=rows, square_m=square_m, markers=markers)
    seen, size_px = _found(wanted, pictures, every)
    result = calibrate(seen, size_px, is_fisheye=fisheye)
    with writing("--out", out):
        out.write_text(result.lens.text(), encoding="utf-8")
    _tell(result, len(seen))
    print_path(out)


def _found(
    board: Board, source: str, every: int
) -> tuple[list[tuple[Points, Points]], tuple[int, int]]:
    """The board's corners in each picture that shows it, and the pictures' size in pixels."""
    seen: list[tuple[Points, Points]] = []
    size_px: tuple[int, int] | None = None
    pictures = islice(pictures_of(source), 0, None, every)
    for number, (name, image) in enumerate(pictures, start=1):
        height, width = image.shape[:2]
        if size_px is not None and size_px != (width, height):
            raise CameraError(
                f"{name}: has {width} x {height} pixels, the others {size_px[0]} x {size_px[1]}; "
                "give pictures of one camera in one mode"
            )
        size_px = width, height
        if (found := board.find(image)) is not None:
            seen.append(found)
        told = f"{len(found[0])} corners" if found else "no board"
        console.print(f"{number}. {name}: {told}", soft_wrap=True, markup=False)
    if size_px is None or len(seen) < _LEAST_PICTURES:
        raise CameraError(
            f"{source}: the board was found in {len(seen)} pictures, and {_LEAST_PICTURES} are "
            f"needed; is it {board.columns}x{board.rows}, flat, whole and sharp in them?"
        )
    return seen, size_px


def _tell(result: Calibrated, num_seen: int) -> None:
    lens = result.lens
    angle_deg = 2.0 * np.degrees(np.arctan(lens.width_px / 2.0 / lens.matrix[0, 0]))
    console.print(
        f"{num_seen} pictures, corners {result.error_px:.2f} pixels off; focal length "
        f"{lens.matrix[0, 0]:.1f} pixels, about {angle_deg:.0f} degrees wide without distortion",
        soft_wrap=True,
    )
    if result.error_px > _GOOD_ERROR_PX:
        console.print(
            f"more than {_GOOD_ERROR_PX:g} pixel off is a lot: was the board flat, --board right, "
            "the pictures sharp? A very wide lens needs --fisheye",
            style="yellow",
            soft_wrap=True,
        )
    if result.share < _GOOD_SHARE:
        console.print(
            f"the board was seen in {result.share:.0%} of the picture's width or height only; "
            "what lies beyond is guessed: hold it into the corners, too",
            style="yellow",
            soft_wrap=True,
        )


def _size(board: str) -> tuple[int, int]:
    columns, _, rows = board.partition("x")
    if not (columns.isdecimal() and rows.isdecimal() and 3 <= min(int(columns), int(rows)) <= 50):
        raise OptionError(f"--board {board!r}: is no size such as 9x6, from 3x3 to 50x50")
    return int(columns), int(rows)
