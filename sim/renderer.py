"""What the downward camera would see of a scene."""

from __future__ import annotations

import math
from functools import partial

import cv2
import numpy as np

from dronemon.frames import AreaFrame
from dronemon.mission.schema import Simulation
from dronemon.types import CameraModel, FloatArray, ImageArray
from sim.exposure import KIND, Exposure, smear
from sim.ground_texture import TEXEL_M, TILE_M, draw_clouds, draw_ground, pyramid
from sim.obstacles import draw_obstacles
from sim.scene import Animal, Scene
from sim.sprites import draw_sprites, stride_m
from sim.view import MIN_HEIGHT_M, NEAREST, View

_SHADOW_PER_M = (0.45, 0.40)
"""Shadow of a pole one metre high, to the north and to the east."""
_SKY = (226, 206, 178)
_TAPE = (168, 196, 206)


class Renderer:
    """Draws pictures of scenes. The same seed and the same scene give the same picture.

    simulation: says how kind light, clouds and shutter are
    """

    def __init__(self, camera: CameraModel, seed: int, simulation: Simulation = KIND) -> None:
        self._camera = camera
        self._shutter_s = simulation.exposure_s
        self._exposure = Exposure(camera, seed, simulation)
        self._clouds = draw_clouds(seed, simulation.shadow) if simulation.shadow else None
        self._tiles = pyramid(draw_ground(seed), 6)

    def render(self, scene: Scene) -> ImageArray:
        """The picture of a scene. -> (height, width, 3) uint8 BGR"""
        view = View(self._camera, scene.pose, scene.frame.ground_down_m)
        image = self._draw_ground(view)
        _draw_tape(image, view, scene.frame)
        for animal in scene.animals:
            self._draw_animal(image, view, animal)
        draw_obstacles(image, view, scene)
        if self._clouds is not None:
            light = self._draw_tile(view, self._clouds, 0)
            image = np.asarray(cv2.multiply(image, cv2.merge([light] * 3), scale=1.0 / 255.0))
        _draw_sky(image, view)
        image = smear(image, self._end_from_start(scene))
        return self._exposure.take(image, scene.pose.time_s)

    def _end_from_start(self, scene: Scene) -> FloatArray:
        """Where the ground of a picture is once the shutter closes, from where it was. -> (3, 3)"""
        start, end = (
            View(self._camera, scene.pose_after(time_s), scene.frame.ground_down_m)
            for time_s in (-0.5 * self._shutter_s, 0.5 * self._shutter_s)
        )
        flown = np.eye(3)  # of ground points, which are seen from the vehicle
        flown[:2, 2] = np.subtract(start.north_east_m, end.north_east_m)
        return end.homography(0.0) @ flown @ np.linalg.inv(start.homography(0.0))

    def _draw_ground(self, view: View) -> ImageArray:
        level = math.log2(1.0 / (view.px_per_m * TEXEL_M))
        level = min(max(round(level), 0), len(self._tiles) - 1)
        return self._draw_tile(view, self._tiles[level], level)

    def _draw_tile(self, view: View, tile: ImageArray, level: int) -> ImageArray:
        """What a tile that covers all ground looks like. level: how often it was halved"""
        texels_per_m = 1.0 / (TEXEL_M * 2**level)
        north_m, east_m = view.north_east_m
        # Indices of the texture: columns run east, rows run south; whole tiles are left out.
        texture_from_ground = np.array(
            [
                [0.0, texels_per_m, (east_m % TILE_M) * texels_per_m - 0.5],
                [-texels_per_m, 0.0, (-north_m % TILE_M) * texels_per_m - 0.5],
                [0.0, 0.0, 1.0],
            ]
        )
        return _warp(
            tile,
            texture_from_ground @ np.linalg.inv(view.homography(0.0)),
            (self._camera.width_px, self._camera.height_px),
            cv2.BORDER_WRAP,
        )

    def _draw_animal(self, image: ImageArray, view: View, animal: Animal) -> None:
        north_m, east_m = np.subtract(animal.position_ned_m, view.north_east_m)
        if not view.is_near(north_m, east_m, animal.up_m):
            return
        phase = animal.walked_m / stride_m(animal.appearance) % 1.0
        sprites = draw_sprites(animal.appearance)
        sprite = sprites[int(phase * len(sprites)) % len(sprites)]
        up_m, height_m = animal.up_m, sprite.top_m
        shadow_m = (north_m + _SHADOW_PER_M[0] * height_m, east_m + _SHADOW_PER_M[1] * height_m)
        shadow_at, at = (*shadow_m, animal.heading_rad), (north_m, east_m, animal.heading_rad)
        stamp = partial(_stamp, image, view, px_per_m=sprite.px_per_m)
        stamp(sprite.upper, at=shadow_at, height_m=up_m, is_shadow=True)
        for fraction in (0.0, 0.35, 0.7):
            stamp(sprite.lower, at=at, height_m=up_m + fraction * height_m)
        stamp(sprite.upper, at=at, height_m=up_m + height_m)


def _warp(
    source: ImageArray, source_from_target: FloatArray, size: tuple[int, int], border: int
) -> ImageArray:
    """Picture of `size` (width, height) whose every pixel is looked up in the source."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(source, source_from_target, size, flags=flags, borderMode=border)
    return np.asarray(warped, np.uint8)


def _stamp(
    image: ImageArray,
    view: View,
    pyramid: tuple[ImageArray, ...],
    *,
    px_per_m: float,
    at: tuple[float, float, float],
    height_m: float,
    is_shadow: bool = False,
) -> None:
    """Lay one layer of a sprite into the picture.

    pyramid: (rows, columns, 4) BGRA, premultiplied, at px_per_m and each half of it
    at:      north, east in m from the vehicle, heading in rad
    """
    if view.height_m - height_m < MIN_HEIGHT_M:
        return
    rows, columns = pyramid[0].shape[:2]
    homography = view.homography(height_m) @ _ground_from_sprite(rows, columns, px_per_m, at)
    corners = np.array([[0, 0, 1], [columns, 0, 1], [columns, rows, 1], [0, rows, 1]])
    projected = (corners - [0.5, 0.5, 0.0]) @ homography.T
    if projected[:, 2].min() < NEAREST * view.height_m:
        return  # at or behind the horizon
    points = projected[:, :2] / projected[:, 2:]
    left, top = np.maximum(np.floor(points.min(axis=0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(points.max(axis=0)).astype(int) + 1, image.shape[1::-1])
    if left >= right or top >= bottom:
        return
    texels_per_px = math.sqrt(rows * columns / max(cv2.contourArea(points.astype(np.float32)), 1.0))
    level = min(max(round(math.log2(texels_per_px)), 0), len(pyramid) - 1)
    shrunk = np.diag([2.0**-level, 2.0**-level, 1.0])
    shrunk[:2, 2] = 0.5 * (2.0**-level - 1.0)
    moved = np.array([[1.0, 0.0, left], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
    layer = _warp(
        pyramid[level],
        shrunk @ np.linalg.inv(homography) @ moved,
        (int(right - left), int(bottom - top)),
        cv2.BORDER_CONSTANT,
    )
    _lay_over(image[top:bottom, left:right], layer, is_shadow=is_shadow)


def _lay_over(part: ImageArray, layer: ImageArray, *, is_shadow: bool) -> None:
    """Mix a layer, or half its shadow, into a part of the picture."""
    alpha = layer[..., 3] // 2 if is_shadow else layer[..., 3]
    share = cv2.cvtColor(255 - alpha, cv2.COLOR_GRAY2BGR)
    part[:] = cv2.multiply(part, share, scale=1.0 / 255.0)
    if not is_shadow:
        part[:] = cv2.add(part, cv2.cvtColor(layer, cv2.COLOR_BGRA2BGR))


def _ground_from_sprite(
    rows: int, columns: int, px_per_m: float, at: tuple[float, float, float]
) -> FloatArray:
    """-> (3, 3) from (column, row, 1) of a sprite to (north, east, 1)"""
    north_m, east_m, heading_rad = at
    s, c = math.sin(heading_rad) / px_per_m, math.cos(heading_rad) / px_per_m
    turned = np.array([[c, -s, north_m], [s, c, east_m], [0.0, 0.0, 1.0]])
    centred = np.eye(3)
    centred[:2, 2] = -0.5 * (columns - 1), -0.5 * (rows - 1)
    moved: FloatArray = turned @ centred
    return moved


def _draw_tape(image: ImageArray, view: View, frame: AreaFrame) -> None:
    """The area's boundary, a pale tape on the ground."""
    corners_m = frame.au_to_ned(frame.arena.outline_au[:-1]) - view.north_east_m
    corners = np.column_stack([corners_m, np.ones(len(corners_m))])
    projected = corners @ view.homography(0.0).T
    thickness = max(1, round(0.12 * view.px_per_m))
    nearest = NEAREST * view.height_m
    for start, end in zip(projected, np.roll(projected, -1, axis=0), strict=True):
        if max(start[2], end[2]) <= nearest:
            continue
        ends = []
        for point, other in ((start, end), (end, start)):
            is_too_near, along = point[2] < nearest, other - point
            inside = point + (nearest - point[2]) / along[2] * along if is_too_near else point
            ends.append([int(v) for v in np.rint(16.0 * inside[:2] / inside[2])])
        cv2.line(image, ends[0], ends[1], _TAPE, thickness, cv2.LINE_AA, 4)


def _draw_sky(image: ImageArray, view: View) -> None:
    """Haze and sky over what is less than a few degrees below the horizon."""
    height, width = image.shape[:2]
    down = view.down_per_pixel()
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]])
    if (corners @ down).min() > 0.05:
        return
    rows, columns = np.arange(height)[:, None], np.arange(width)[None, :]
    image[columns * down[0] + rows * down[1] + down[2] <= 0.05] = _SKY
