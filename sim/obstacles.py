"""What stands on the ground and hides what is behind it: plain walls and roofs."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from dronemon.types import FloatArray, ImageArray
from sim.scene import Scene
from sim.view import MIN_HEIGHT_M, View

_STONE = np.array([138.0, 142.0, 146.0])
_LIGHT = np.array([-0.75, -0.66])
"""Where the light comes from, north and east, as shadows fall the other way."""
_ROOF_SHADE, _WALL_SHADE, _WALL_LIGHT = 1.0, 0.8, 0.12
_MARGIN_PX = 2.0
_SUBPIXEL_BITS = 4


def draw_obstacles(image: ImageArray, view: View, scene: Scene) -> None:
    """Draw them over what is there: the farthest first, its walls before its roof."""
    laid = [
        (scene.frame.au_to_ned(obstacle.corners_au) - view.north_east_m, obstacle, up_m)
        for obstacle, up_m in scene.obstacles
    ]
    for corners_m, obstacle, up_m in sorted(laid, key=lambda each: -_away_m(each[0])):
        for face, shade in _faces(view, corners_m, (up_m, up_m + obstacle.height_m)):
            _fill(image, _in_picture(face, view), shade)


def _away_m(corners_m: FloatArray) -> float:
    """How far off the nearest of its walls is, by corner and middle. (K, 2) -> m"""
    middles_m = 0.5 * (corners_m + np.roll(corners_m, -1, axis=0))
    return float(np.linalg.norm([*corners_m, *middles_m], axis=-1).min())


def _faces(
    view: View, corners_m: FloatArray, ends_m: tuple[float, float]
) -> Iterator[tuple[FloatArray, float]]:
    """Walls from the farthest to the nearest, and the roof where it is seen from above.

    corners_m: (K, 2) north, east from the vehicle
    ends_m:    heights of its foot and its top above the ground below the camera
    -> (k, 3) column, row, 1 by depth; brightness
    """
    on_plane = np.column_stack([corners_m, np.ones(len(corners_m))])
    foot, top = (on_plane @ view.homography(height_m).T for height_m in ends_m)
    along_m = np.roll(corners_m, -1, axis=0) - corners_m
    x, y = corners_m.T
    is_clockwise = x @ np.roll(y, -1) > y @ np.roll(x, -1)  # north to east
    out = along_m @ np.array([[0.0, -1.0], [1.0, 0.0]]) * (1.0 if is_clockwise else -1.0)
    lit = (out / np.linalg.norm(out, axis=-1, keepdims=True)) @ _LIGHT
    for wall in np.argsort(-np.linalg.norm(corners_m + 0.5 * along_m, axis=-1)):
        after = (wall + 1) % len(corners_m)
        shade = _WALL_SHADE + _WALL_LIGHT * lit[wall]
        yield np.stack([foot[wall], foot[after], top[after], top[wall]]), shade
    if ends_m[1] < view.height_m:
        yield top, _ROOF_SHADE


def _in_picture(face: FloatArray, view: View) -> FloatArray:
    """The part of a face that shows. (k, 3) -> (m, 2) column, row

    Source: Sutherland and Hodgman (1974).
    """
    width, height = view.size_px + _MARGIN_PX
    planes = np.array(
        [
            *([0.0, 0.0, 1.0, -MIN_HEIGHT_M], [1.0, 0.0, _MARGIN_PX, 0.0]),
            *([0.0, 1.0, _MARGIN_PX, 0.0], [-1.0, 0.0, width, 0.0], [0.0, -1.0, height, 0.0]),
        ]
    )
    for plane in planes:
        if not len(face):
            break
        inside = face @ plane[:3] + plane[3]
        part = []
        for at in range(len(face)):
            here, before = inside[at], inside[at - 1]
            if (here < 0.0) != (before < 0.0):
                part.append(face[at - 1] + before / (before - here) * (face[at] - face[at - 1]))
            if here >= 0.0:
                part.append(face[at])
        face = np.reshape(part, (-1, 3))
    shown: FloatArray = face[:, :2] / face[:, 2:]
    return shown


def _fill(image: ImageArray, corners_px: FloatArray, shade: float) -> None:
    if len(corners_px) < 3:
        return
    at = np.rint(corners_px * 2**_SUBPIXEL_BITS).astype(np.int32)
    colour = tuple((shade * _STONE).tolist())
    cv2.fillPoly(image, [at], colour, cv2.LINE_AA, _SUBPIXEL_BITS)
