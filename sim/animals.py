"""How the simulated animals look from above: outlines, coats and gait, drawn once as sprites.

Lengths in the drawings are those of real animals, in metres: x towards the nose, y to the right.
DRAWN_SCALE enlarges all of them by
the same factor, since at 35 m height a real fox would be four pixels wide.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from dronemon.mission.schema import APPEARANCES
from dronemon.types import ImageArray

DRAWN_SCALE = 1.8
"""Drawn length over real length, the same for every animal."""
NUM_PHASES = 8
"""Pictures of one stride."""
SPRITE_PX_PER_M = 32.0
"""Finest resolution of sprites, in pixels per drawn metre."""
NUM_LEVELS = 4
"""Resolutions of each sprite, each half of the one before."""

_Field = NDArray[np.floating]
_Coat = Callable[[_Field, _Field], _Field]
_MARGIN_M = 0.2
_ANTLERS_M = 0.45
_TRUNK_HEIGHT = 0.65
"""Height of the plane that the trunk is drawn in, over the height of the back."""

# Colours are BGR, 0 to 1.
_BLACK = (0.07, 0.07, 0.08)
_WHITE = (0.93, 0.96, 0.97)
_PALE = (0.62, 0.66, 0.68)
_WOOL = (0.80, 0.90, 0.94)
_TAN = (0.30, 0.50, 0.72)
_CHESTNUT = (0.09, 0.17, 0.36)
_RUSSET = (0.10, 0.37, 0.88)
_TIGER = (0.12, 0.50, 0.96)


@dataclass(frozen=True, slots=True, kw_only=True)
class Form:
    """The shape of one kind of animal from above, in real metres.

    outline_m: (x, half width) from rump to nose; the x origin may be anywhere, sprites centre it.
    """

    outline_m: tuple[tuple[float, float], ...]
    back_height_m: float
    legs_m: tuple[float, float, float, float]
    """x of the hind and of the fore legs, half their distance, and their radius."""
    stride_m: float
    leg_colour: tuple[float, float, float]
    tail_m: tuple[float, float]
    """Length and radius."""
    tail_colours: tuple[tuple[float, float, float], tuple[float, float, float]]
    """At its root and at its tip."""
    ears_m: tuple[float, float, float]
    """x, half their distance, radius."""
    ear_colour: tuple[float, float, float]
    antlers: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Sprite:
    """One animal in one phase of its stride, seen from above, its nose towards column infinity.

    legs, body: (rows, columns, 4) uint8 BGRA, premultiplied by alpha, at SPRITE_PX_PER_M and at
    each half of it. The animal's centre is the sprite's; a row further down is further right.
    """

    legs: tuple[ImageArray, ...]
    body: tuple[ImageArray, ...]
    body_height_m: float


@cache
def draw_sprites(appearance: str) -> tuple[Sprite, ...]:
    """The NUM_PHASES sprites of one stride."""
    form, coat = _FORMS[appearance], _COATS[appearance]
    canvas = _Canvas.around(form)
    return tuple(_draw(form, coat, canvas, i / NUM_PHASES) for i in range(NUM_PHASES))


def stride_m(appearance: str) -> float:
    """Ground covered in one stride, as drawn."""
    return _FORMS[appearance].stride_m * DRAWN_SCALE


def drawn_size_m(appearance: str) -> tuple[float, float, float]:
    """Length from nose to tail, both legs' and ears' width, and height of the trunk, as drawn."""
    form = _FORMS[appearance]
    x, half_width = np.array(form.outline_m).T
    centre = _centre_m(form)
    length = 2.0 * max(x.max() - centre, centre - x.min() + form.tail_m[0])
    width = 2.0 * max(half_width.max(), _ANTLERS_M if form.antlers else 0.0, form.legs_m[2] + 0.1)
    height = _TRUNK_HEIGHT * form.back_height_m
    return length * DRAWN_SCALE, width * DRAWN_SCALE, height * DRAWN_SCALE


def _centre_m(form: Form) -> float:
    """Centre of area of the outline along x."""
    x, half_width = np.array(form.outline_m).T
    return float(np.trapezoid(x * half_width, x) / np.trapezoid(half_width, x))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Canvas:
    """A grid of real metres around an animal's centre. x, y: (rows, columns) m."""

    x: _Field
    y: _Field
    px_per_m: float

    @staticmethod
    def around(form: Form) -> _Canvas:
        """Large enough for the whole animal, its outline's centre of area in the middle."""
        x, half_width = np.array(form.outline_m).T
        centre_m = _centre_m(form)
        reach = max(x.max() - centre_m, centre_m - x.min() + form.tail_m[0]) + _MARGIN_M
        breadth = max(half_width.max(), _ANTLERS_M if form.antlers else 0.0) + _MARGIN_M
        px_per_m = SPRITE_PX_PER_M * DRAWN_SCALE
        multiple = 2**NUM_LEVELS
        columns = math.ceil(reach * px_per_m / multiple) * multiple
        rows = math.ceil(breadth * px_per_m / multiple) * multiple
        axis_x = (np.arange(-columns, columns) + 0.5) / px_per_m + centre_m
        axis_y = (np.arange(-rows, rows) + 0.5) / px_per_m
        grid_y, grid_x = np.meshgrid(axis_y, axis_x, indexing="ij")
        return _Canvas(x=grid_x.astype(np.float32), y=grid_y.astype(np.float32), px_per_m=px_per_m)

    def inside(self, depth_m: _Field) -> _Field:
        """Coverage of a shape by the signed depth of each pixel below its edge. -> 0 to 1."""
        coverage: _Field = np.clip(depth_m * self.px_per_m + 0.5, 0.0, 1.0)
        return coverage

    def disc(self, x_m: float, y_m: float, radius_m: float) -> _Field:
        """Coverage of a disc."""
        return self.inside(radius_m - np.hypot(self.x - x_m, self.y - y_m))

    def capsule(
        self, start_m: tuple[float, float], end_m: tuple[float, float], radius_m: float
    ) -> _Field:
        """Coverage of a thick line with round ends."""
        along = np.array(end_m) - np.array(start_m)
        dx, dy = self.x - start_m[0], self.y - start_m[1]
        t = np.clip((dx * along[0] + dy * along[1]) / (along @ along), 0.0, 1.0)
        return self.inside(radius_m - np.hypot(dx - t * along[0], dy - t * along[1]))


class _Layer:
    """Premultiplied colour and alpha, painted over piece by piece."""

    def __init__(self, canvas: _Canvas) -> None:
        self._bgra = np.zeros((*canvas.x.shape, 4), np.float32)

    def paint(self, coverage: _Field, colour: tuple[float, float, float] | _Field) -> None:
        """Lay a colour, or one colour for each pixel, over what is there."""
        a = coverage[..., None]
        bgr = np.broadcast_to(np.array(colour, np.float32), (*coverage.shape, 3))
        self._bgra[..., :3] += a * (bgr - self._bgra[..., :3])
        self._bgra[..., 3:] += a * (1.0 - self._bgra[..., 3:])

    def images(self) -> tuple[ImageArray, ...]:
        """-> NUM_LEVELS times (rows, columns, 4) uint8"""
        rows, columns = self._bgra.shape[:2]
        images = []
        for level in range(NUM_LEVELS):
            size = (columns >> level, rows >> level)
            small = cv2.resize(self._bgra, size, interpolation=cv2.INTER_AREA)
            images.append(np.rint(np.clip(small, 0.0, 1.0) * 255.0).astype(np.uint8))
        return tuple(images)


def _draw(form: Form, coat: _Coat, canvas: _Canvas, phase: float) -> Sprite:
    swing = math.sin(2.0 * math.pi * phase)
    legs, body = _Layer(canvas), _Layer(canvas)
    _draw_legs(legs, form, canvas, phase)

    # The spine bends from side to side by a few centimetres with the stride.
    y = canvas.y - 0.02 * swing * np.sin(3.0 * canvas.x)
    x_m, half_width_m = np.array(form.outline_m).T
    _draw_tail(body, form, canvas, swing, x_m.min())
    half_width = PchipInterpolator(x_m, half_width_m)(np.clip(canvas.x, x_m[0], x_m[-1]))
    ends = np.minimum(canvas.x - x_m.min(), x_m.max() - canvas.x)
    roundness = np.clip(1.0 - (y / np.maximum(half_width, 1e-3)) ** 2, 0.0, 1.0)
    shade = (0.72 + 0.30 * np.sqrt(roundness))[..., None]
    colour = np.clip(coat(canvas.x, y) * shade, 0.0, 1.0)
    body.paint(canvas.inside(np.minimum(half_width - np.abs(y), ends)), colour)

    ear_x, ear_y, ear_radius = form.ears_m
    for side in (-1.0, 1.0):
        body.paint(canvas.disc(ear_x, side * ear_y, ear_radius), form.ear_colour)
        if form.antlers:
            _draw_antler(body, canvas, ear_x, side)
    return Sprite(
        legs=legs.images(),
        body=body.images(),
        body_height_m=_TRUNK_HEIGHT * form.back_height_m * DRAWN_SCALE,
    )


def _draw_legs(layer: _Layer, form: Form, canvas: _Canvas, phase: float) -> None:
    """Four legs in the order of a walk: each a quarter of a stride after the one before."""
    hind_x, fore_x, half_distance, radius = form.legs_m
    reach = 0.25 * form.stride_m
    for x, side, lag in (
        (hind_x, -1, 0.0),
        (fore_x, -1, 0.25),
        (hind_x, 1, 0.5),
        (fore_x, 1, 0.75),
    ):
        foot = x + reach * math.sin(2.0 * math.pi * (phase - lag))
        y = side * half_distance
        layer.paint(canvas.capsule((x, 0.8 * y), (foot, y), radius), form.leg_colour)


def _draw_tail(layer: _Layer, form: Form, canvas: _Canvas, swing: float, rump_m: float) -> None:
    length, radius = form.tail_m
    root, tip = form.tail_colours
    middle = (rump_m - 0.65 * length, 0.10 * length * swing)
    end = (rump_m - length, -0.18 * length * swing)
    layer.paint(canvas.capsule((rump_m + 0.05, 0.0), middle, radius), root)
    layer.paint(canvas.capsule(middle, end, radius), tip)


def _draw_antler(layer: _Layer, canvas: _Canvas, x: float, side: float) -> None:
    beam = (x - 0.20, side * 0.34)
    layer.paint(canvas.capsule((x, side * 0.08), beam, 0.025), (0.42, 0.60, 0.72))
    layer.paint(canvas.capsule(beam, (x + 0.08, side * 0.42), 0.025), (0.42, 0.60, 0.72))
    layer.paint(
        canvas.capsule((x - 0.1, side * 0.2), (x + 0.1, side * 0.26), 0.02), (0.42, 0.60, 0.72)
    )


def _plain(x: _Field, colour: tuple[float, float, float]) -> _Field:
    return np.broadcast_to(np.array(colour, np.float32), (*x.shape, 3)).copy()


def _mix(base: _Field, colour: tuple[float, float, float], weight: _Field) -> _Field:
    return base + np.clip(weight, 0.0, 1.0)[..., None] * (np.array(colour, np.float32) - base)


def _cow(x: _Field, y: _Field) -> _Field:
    """White with large black patches and a black head."""
    patches = np.sin(3.9 * x + 0.8) * np.cos(4.2 * y + 0.9) + 0.5 * np.sin(6.1 * x - 5.0 * y + 1.0)
    coat = _mix(_plain(x, _WHITE), _BLACK, 14.0 * (patches - 0.05))
    coat = _mix(coat, _BLACK, 20.0 * (x - 0.80))
    return _mix(coat, _WHITE, 20.0 * (0.05 - np.abs(y)) * (x > 0.85))  # blaze


def _deer(x: _Field, y: _Field) -> _Field:
    """Light tan with white spots, a darker spine and a white rump."""
    spots = np.sin(24.0 * x) * np.sin(30.0 * y)
    coat = _mix(_plain(x, _TAN), _WHITE, 4.0 * (spots - 0.6) * (np.abs(x) < 0.5))
    coat = _mix(coat, (0.16, 0.30, 0.45), 12.0 * (0.05 - np.abs(y)))
    return _mix(coat, _WHITE, 16.0 * (-0.52 - x))


def _fox(x: _Field, y: _Field) -> _Field:
    """Russet with a white muzzle."""
    return _mix(_plain(x, _RUSSET), _WHITE, 18.0 * (x - 0.44))


def _horse(x: _Field, y: _Field) -> _Field:
    """Dark chestnut with a black mane."""
    mane = 25.0 * (0.06 - np.abs(y)) * ((x > 0.45) & (x < 1.05))
    return _mix(_plain(x, _CHESTNUT), _BLACK, mane)


def _panda(x: _Field, y: _Field) -> _Field:
    """White with a black band over the shoulders and black patches around the eyes."""
    coat = _mix(_plain(x, _WHITE), _BLACK, 16.0 * (0.17 - np.abs(x - 0.30)))
    return _mix(coat, _BLACK, 20.0 * (0.07 - np.hypot(x - 0.72, np.abs(y) - 0.12)))


def _sheep(x: _Field, y: _Field) -> _Field:
    """Cream wool in curls, with a black face."""
    curls = np.sin(27.0 * x) * np.sin(27.0 * y)
    coat = _plain(x, _WOOL) * (1.0 + 0.08 * curls)[..., None]
    return _mix(coat, _BLACK, 25.0 * (x - 0.50))


def _tiger(x: _Field, y: _Field) -> _Field:
    """Bright orange with thin black stripes across and pale flanks."""
    coat = _mix(_plain(x, _TIGER), (0.70, 0.85, 0.95), 6.0 * (np.abs(y) - 0.20))
    stripes = np.sin(30.0 * x + 3.0 * np.abs(y)) - 0.25
    return _mix(coat, _BLACK, 3.0 * stripes * (np.abs(x) < 0.75))


def _zebra(x: _Field, y: _Field) -> _Field:
    """White with broad black stripes across and a black muzzle."""
    stripes = np.sin(21.0 * x + 2.0 * np.abs(y))
    coat = _mix(_plain(x, _WHITE), _BLACK, 4.0 * stripes + 0.5)
    return _mix(coat, _BLACK, 20.0 * (x - 1.12))


_COATS: dict[str, _Coat] = {
    "cow": _cow,
    "deer": _deer,
    "fox": _fox,
    "horse": _horse,
    "panda": _panda,
    "sheep": _sheep,
    "tiger": _tiger,
    "zebra": _zebra,
}

_FORMS: dict[str, Form] = {
    "cow": Form(
        outline_m=(
            (-0.95, 0.10),
            (-0.85, 0.27),
            (-0.5, 0.33),
            (0.0, 0.38),
            (0.45, 0.31),
            (0.70, 0.18),
            (0.85, 0.15),
            (1.0, 0.16),
            (1.2, 0.10),
            (1.3, 0.06),
        ),
        back_height_m=1.4,
        legs_m=(-0.65, 0.45, 0.28, 0.07),
        stride_m=1.3,
        leg_colour=_PALE,
        tail_m=(0.30, 0.03),
        tail_colours=(_WHITE, _BLACK),
        ears_m=(0.93, 0.20, 0.06),
        ear_colour=_BLACK,
    ),
    "deer": Form(
        outline_m=(
            (-0.70, 0.08),
            (-0.60, 0.19),
            (-0.3, 0.22),
            (0.05, 0.22),
            (0.35, 0.17),
            (0.50, 0.09),
            (0.72, 0.08),
            (0.82, 0.10),
            (0.98, 0.07),
            (1.08, 0.04),
        ),
        back_height_m=1.0,
        legs_m=(-0.45, 0.30, 0.16, 0.045),
        stride_m=1.1,
        leg_colour=_TAN,
        tail_m=(0.15, 0.05),
        tail_colours=(_WHITE, _WHITE),
        ears_m=(0.76, 0.15, 0.05),
        ear_colour=_TAN,
        antlers=True,
    ),
    "fox": Form(
        outline_m=(
            (-0.40, 0.07),
            (-0.32, 0.13),
            (0.0, 0.14),
            (0.18, 0.13),
            (0.28, 0.10),
            (0.38, 0.11),
            (0.46, 0.07),
            (0.56, 0.03),
        ),
        back_height_m=0.45,
        legs_m=(-0.25, 0.18, 0.11, 0.035),
        stride_m=0.6,
        leg_colour=_BLACK,
        tail_m=(0.42, 0.075),
        tail_colours=(_RUSSET, _WHITE),
        ears_m=(0.34, 0.10, 0.045),
        ear_colour=_BLACK,
    ),
    "horse": Form(
        outline_m=(
            (-1.0, 0.12),
            (-0.88, 0.27),
            (-0.55, 0.31),
            (-0.1, 0.28),
            (0.3, 0.29),
            (0.55, 0.20),
            (0.75, 0.12),
            (1.0, 0.10),
            (1.2, 0.11),
            (1.4, 0.07),
            (1.5, 0.05),
        ),
        back_height_m=1.55,
        legs_m=(-0.70, 0.40, 0.24, 0.06),
        stride_m=1.7,
        leg_colour=_BLACK,
        tail_m=(0.45, 0.07),
        tail_colours=(_BLACK, _BLACK),
        ears_m=(1.08, 0.09, 0.045),
        ear_colour=_CHESTNUT,
    ),
    "panda": Form(
        outline_m=(
            (-0.75, 0.12),
            (-0.62, 0.32),
            (-0.25, 0.40),
            (0.1, 0.37),
            (0.38, 0.28),
            (0.48, 0.21),
            (0.60, 0.25),
            (0.75, 0.22),
            (0.88, 0.12),
            (0.95, 0.06),
        ),
        back_height_m=0.75,
        legs_m=(-0.45, 0.32, 0.36, 0.12),
        stride_m=0.8,
        leg_colour=_BLACK,
        tail_m=(0.10, 0.05),
        tail_colours=(_WHITE, _WHITE),
        ears_m=(0.56, 0.22, 0.09),
        ear_colour=_BLACK,
    ),
    "sheep": Form(
        outline_m=(
            (-0.62, 0.12),
            (-0.52, 0.26),
            (-0.25, 0.31),
            (0.1, 0.31),
            (0.35, 0.25),
            (0.48, 0.14),
            (0.60, 0.12),
            (0.72, 0.09),
            (0.80, 0.05),
        ),
        back_height_m=0.8,
        legs_m=(-0.40, 0.28, 0.22, 0.05),
        stride_m=0.8,
        leg_colour=_BLACK,
        tail_m=(0.16, 0.06),
        tail_colours=(_WOOL, _WOOL),
        ears_m=(0.55, 0.15, 0.05),
        ear_colour=_BLACK,
    ),
    "tiger": Form(
        outline_m=(
            (-0.80, 0.10),
            (-0.70, 0.20),
            (-0.35, 0.23),
            (0.1, 0.22),
            (0.45, 0.23),
            (0.62, 0.16),
            (0.75, 0.17),
            (0.90, 0.14),
            (1.02, 0.07),
        ),
        back_height_m=0.95,
        legs_m=(-0.50, 0.42, 0.20, 0.075),
        stride_m=1.2,
        leg_colour=_TIGER,
        tail_m=(0.85, 0.05),
        tail_colours=(_TIGER, _BLACK),
        ears_m=(0.72, 0.14, 0.05),
        ear_colour=_BLACK,
    ),
    "zebra": Form(
        outline_m=(
            (-0.95, 0.12),
            (-0.82, 0.26),
            (-0.5, 0.30),
            (-0.1, 0.28),
            (0.25, 0.28),
            (0.50, 0.19),
            (0.70, 0.12),
            (0.92, 0.10),
            (1.08, 0.11),
            (1.25, 0.07),
            (1.32, 0.05),
        ),
        back_height_m=1.35,
        legs_m=(-0.65, 0.38, 0.22, 0.055),
        stride_m=1.5,
        leg_colour=_PALE,
        tail_m=(0.38, 0.04),
        tail_colours=(_WHITE, _BLACK),
        ears_m=(0.98, 0.09, 0.05),
        ear_colour=_BLACK,
    ),
}
assert set(_FORMS) == set(_COATS) == set(APPEARANCES)
