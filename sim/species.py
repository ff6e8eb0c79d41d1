"""The animals of the simulated world: their shapes and coats from above.

Lengths are those of real animals, in metres: x towards the nose, y to the right.
DRAWN_SCALE enlarges all of them, since at 35 m height a real fox would be three pixels wide.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from dronemon.types import Vector3
from sim.painting import NUM_PHASES, SPRITE_PX_PER_M, Canvas, Field, Layer

DRAWN_SCALE = 1.8
"""Drawn length over real length, the same for every animal."""
Coat = Callable[[Field, Field], Field]
"""Colour of the coat at x, y: (rows, columns) m each -> (rows, columns, 3) BGR, 0 to 1."""

# Colours are BGR, 0 to 1.
_BLACK = (0.07, 0.07, 0.08)
_WHITE = (0.93, 0.96, 0.97)
_PALE = (0.62, 0.66, 0.68)
_WOOL = (0.80, 0.90, 0.94)
_TAN = (0.30, 0.50, 0.72)
_CHESTNUT = (0.09, 0.17, 0.36)
_RUSSET = (0.10, 0.37, 0.88)
_TIGER = (0.12, 0.50, 0.96)
_HORN = (0.42, 0.60, 0.72)
_ANTLERS_M = 0.45
_TRUNK_HEIGHT = 0.65
"""Height of the plane that the trunk is drawn in, over the height of the back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Species:
    """One kind of animal from above, in real metres; the x origin may be anywhere."""

    coat: Coat
    outline_x_m: tuple[float, ...]
    """From rump to nose."""
    half_width_m: tuple[float, ...]
    """Of the trunk, at each x of the outline."""
    back_height_m: float
    legs: tuple[float, float, float, float, Vector3]
    """x of the hind and of the fore legs, half their distance and radius in m, colour."""
    stride_m: float
    tail: tuple[float, float, Vector3, Vector3]
    """Length and radius in m, colours at its root and at its tip."""
    ears: tuple[float, float, float, Vector3]
    """x, half their distance and radius in m, colour."""
    has_antlers: bool = False
    px_per_m: float = SPRITE_PX_PER_M

    @property
    def centre_x_m(self) -> float:
        """Centre of the outline's area."""
        x, half_width = np.array(self.outline_x_m), np.array(self.half_width_m)
        return float(np.trapezoid(x * half_width, x) / np.trapezoid(half_width, x))

    @property
    def half_length_m(self) -> float:
        """From the centre to the nose or the tip of the tail, whichever is further."""
        rump_m, nose_m = self.outline_x_m[0], self.outline_x_m[-1]
        return max(nose_m - self.centre_x_m, self.centre_x_m - rump_m + self.tail[0])

    @property
    def half_breadth_m(self) -> float:
        """Of the trunk, the legs or the antlers, whichever are wider."""
        antlers_m = _ANTLERS_M if self.has_antlers else 0.0
        return max(*self.half_width_m, self.legs[2] + 0.1, antlers_m)

    @property
    def scale(self) -> float:
        """Drawn length over real length."""
        return DRAWN_SCALE

    @property
    def top_m(self) -> float:
        """Height of the plane that the trunk is drawn in."""
        return _TRUNK_HEIGHT * self.back_height_m

    @property
    def num_phases(self) -> int:
        """Pictures of one stride."""
        return NUM_PHASES

    def paint(self, canvas: Canvas, phase: float) -> tuple[Layer, Layer]:
        """Legs, and all above them, in one phase of a stride."""
        swing = math.sin(2.0 * math.pi * phase)
        legs, body = Layer(canvas), Layer(canvas)
        _draw_legs(legs, self, canvas, phase)

        # The spine bends from side to side by a few centimetres with the stride.
        y = canvas.y - 0.02 * swing * np.sin(3.0 * canvas.x)
        _draw_tail(body, self, canvas, swing)
        x_m = np.array(self.outline_x_m)
        outline = PchipInterpolator(x_m, self.half_width_m)
        half_width = outline(np.clip(canvas.x, x_m[0], x_m[-1]))
        ends = np.minimum(canvas.x - x_m[0], x_m[-1] - canvas.x)
        roundness = np.clip(1.0 - (y / np.maximum(half_width, 1e-3)) ** 2, 0.0, 1.0)
        shade = (0.72 + 0.30 * np.sqrt(roundness))[..., None]
        colour = np.clip(self.coat(canvas.x, y) * shade, 0.0, 1.0)
        body.paint(canvas.inside(np.minimum(half_width - np.abs(y), ends)), colour)

        ear_x, ear_y, ear_radius, ear_colour = self.ears
        for side in (-1.0, 1.0):
            body.paint(canvas.disc(ear_x, side * ear_y, ear_radius), ear_colour)
            if self.has_antlers:
                _draw_antler(body, canvas, ear_x, side)
        return legs, body


def _draw_legs(layer: Layer, species: Species, canvas: Canvas, phase: float) -> None:
    """Four legs in the order of a walk: each a quarter of a stride after the one before."""
    hind_x, fore_x, half_distance, radius, colour = species.legs
    reach = 0.25 * species.stride_m
    walk = ((hind_x, -1), (fore_x, -1), (hind_x, 1), (fore_x, 1))
    for quarter, (x, side) in enumerate(walk):
        foot = x + reach * math.sin(2.0 * math.pi * (phase - 0.25 * quarter))
        y = side * half_distance
        layer.paint(canvas.capsule((x, 0.8 * y), (foot, y), radius), colour)


def _draw_tail(layer: Layer, species: Species, canvas: Canvas, swing: float) -> None:
    rump_m, (length, radius, root, tip) = species.outline_x_m[0], species.tail
    middle = (rump_m - 0.65 * length, 0.10 * length * swing)
    end = (rump_m - length, -0.18 * length * swing)
    layer.paint(canvas.capsule((rump_m + 0.05, 0.0), middle, radius), root)
    layer.paint(canvas.capsule(middle, end, radius), tip)


def _draw_antler(layer: Layer, canvas: Canvas, x: float, side: float) -> None:
    beam = (x - 0.20, side * 0.34)
    layer.paint(canvas.capsule((x, side * 0.08), beam, 0.025), _HORN)
    layer.paint(canvas.capsule(beam, (x + 0.08, side * 0.42), 0.025), _HORN)
    layer.paint(canvas.capsule((x - 0.1, side * 0.2), (x + 0.1, side * 0.26), 0.02), _HORN)


def _plain(x: Field, colour: Vector3) -> Field:
    return np.broadcast_to(np.array(colour, np.float32), (*x.shape, 3)).copy()


def _mix(base: Field, colour: Vector3, weight: Field) -> Field:
    return base + np.clip(weight, 0.0, 1.0)[..., None] * (np.array(colour, np.float32) - base)


def _cow(x: Field, y: Field) -> Field:
    """White with large black patches and a black head."""
    patches = np.sin(3.9 * x + 0.8) * np.cos(4.2 * y + 0.9) + 0.5 * np.sin(6.1 * x - 5.0 * y + 1.0)
    coat = _mix(_plain(x, _WHITE), _BLACK, 14.0 * (patches - 0.05))
    coat = _mix(coat, _BLACK, 20.0 * (x - 0.80))
    return _mix(coat, _WHITE, 20.0 * (0.05 - np.abs(y)) * (x > 0.85))  # blaze


def _deer(x: Field, y: Field) -> Field:
    """Light tan with white spots, a darker spine and a white rump."""
    spots = np.sin(24.0 * x) * np.sin(30.0 * y)
    coat = _mix(_plain(x, _TAN), _WHITE, 4.0 * (spots - 0.6) * (np.abs(x) < 0.5))
    coat = _mix(coat, (0.16, 0.30, 0.45), 12.0 * (0.05 - np.abs(y)))
    return _mix(coat, _WHITE, 16.0 * (-0.52 - x))


def _fox(x: Field, y: Field) -> Field:
    """Russet with a white muzzle."""
    return _mix(_plain(x, _RUSSET), _WHITE, 18.0 * (x - 0.44))


def _horse(x: Field, y: Field) -> Field:
    """Dark chestnut with a black mane."""
    mane = 25.0 * (0.06 - np.abs(y)) * ((x > 0.45) & (x < 1.05))
    return _mix(_plain(x, _CHESTNUT), _BLACK, mane)


def _panda(x: Field, y: Field) -> Field:
    """White with a black band over the shoulders and black patches around the eyes."""
    coat = _mix(_plain(x, _WHITE), _BLACK, 16.0 * (0.17 - np.abs(x - 0.30)))
    return _mix(coat, _BLACK, 20.0 * (0.07 - np.hypot(x - 0.72, np.abs(y) - 0.12)))


def _sheep(x: Field, y: Field) -> Field:
    """Cream wool in curls, with a black face."""
    curls = np.sin(27.0 * x) * np.sin(27.0 * y)
    coat = _plain(x, _WOOL) * (1.0 + 0.08 * curls)[..., None]
    return _mix(coat, _BLACK, 25.0 * (x - 0.50))


def _tiger(x: Field, y: Field) -> Field:
    """Bright orange with thin black stripes across and pale flanks."""
    coat = _mix(_plain(x, _TIGER), (0.70, 0.85, 0.95), 6.0 * (np.abs(y) - 0.20))
    stripes = np.sin(30.0 * x + 3.0 * np.abs(y)) - 0.25
    return _mix(coat, _BLACK, 3.0 * stripes * (np.abs(x) < 0.75))


def _zebra(x: Field, y: Field) -> Field:
    """White with broad black stripes across and a black muzzle."""
    stripes = np.sin(21.0 * x + 2.0 * np.abs(y))
    coat = _mix(_plain(x, _WHITE), _BLACK, 4.0 * stripes + 0.5)
    return _mix(coat, _BLACK, 20.0 * (x - 1.12))


SPECIES: dict[str, Species] = {
    "cow": Species(
        coat=_cow,
        outline_x_m=(-0.95, -0.85, -0.5, 0.0, 0.45, 0.70, 0.85, 1.0, 1.2, 1.3),
        half_width_m=(0.10, 0.27, 0.33, 0.38, 0.31, 0.18, 0.15, 0.16, 0.10, 0.06),
        back_height_m=1.4,
        legs=(-0.65, 0.45, 0.28, 0.07, _PALE),
        stride_m=1.3,
        tail=(0.30, 0.03, _WHITE, _BLACK),
        ears=(0.93, 0.20, 0.06, _BLACK),
    ),
    "deer": Species(
        coat=_deer,
        outline_x_m=(-0.70, -0.60, -0.3, 0.05, 0.35, 0.50, 0.72, 0.82, 0.98, 1.08),
        half_width_m=(0.08, 0.19, 0.22, 0.22, 0.17, 0.09, 0.08, 0.10, 0.07, 0.04),
        back_height_m=1.0,
        legs=(-0.45, 0.30, 0.16, 0.045, _TAN),
        stride_m=1.1,
        tail=(0.15, 0.05, _WHITE, _WHITE),
        ears=(0.76, 0.15, 0.05, _TAN),
        has_antlers=True,
    ),
    "fox": Species(
        coat=_fox,
        outline_x_m=(-0.40, -0.32, 0.0, 0.18, 0.28, 0.38, 0.46, 0.56),
        half_width_m=(0.07, 0.13, 0.14, 0.13, 0.10, 0.11, 0.07, 0.03),
        back_height_m=0.45,
        legs=(-0.25, 0.18, 0.11, 0.035, _BLACK),
        stride_m=0.6,
        tail=(0.42, 0.075, _RUSSET, _WHITE),
        ears=(0.34, 0.10, 0.045, _BLACK),
    ),
    "horse": Species(
        coat=_horse,
        outline_x_m=(-1.0, -0.88, -0.55, -0.1, 0.3, 0.55, 0.75, 1.0, 1.2, 1.4, 1.5),
        half_width_m=(0.12, 0.27, 0.31, 0.28, 0.29, 0.20, 0.12, 0.10, 0.11, 0.07, 0.05),
        back_height_m=1.55,
        legs=(-0.70, 0.40, 0.24, 0.06, _BLACK),
        stride_m=1.7,
        tail=(0.45, 0.07, _BLACK, _BLACK),
        ears=(1.08, 0.09, 0.045, _CHESTNUT),
    ),
    "panda": Species(
        coat=_panda,
        outline_x_m=(-0.75, -0.62, -0.25, 0.1, 0.38, 0.48, 0.60, 0.75, 0.88, 0.95),
        half_width_m=(0.12, 0.32, 0.40, 0.37, 0.28, 0.21, 0.25, 0.22, 0.12, 0.06),
        back_height_m=0.75,
        legs=(-0.45, 0.32, 0.36, 0.12, _BLACK),
        stride_m=0.8,
        tail=(0.10, 0.05, _WHITE, _WHITE),
        ears=(0.56, 0.22, 0.09, _BLACK),
    ),
    "sheep": Species(
        coat=_sheep,
        outline_x_m=(-0.62, -0.52, -0.25, 0.1, 0.35, 0.48, 0.60, 0.72, 0.80),
        half_width_m=(0.12, 0.26, 0.31, 0.31, 0.25, 0.14, 0.12, 0.09, 0.05),
        back_height_m=0.8,
        legs=(-0.40, 0.28, 0.22, 0.05, _BLACK),
        stride_m=0.8,
        tail=(0.16, 0.06, _WOOL, _WOOL),
        ears=(0.55, 0.15, 0.05, _BLACK),
    ),
    "tiger": Species(
        coat=_tiger,
        outline_x_m=(-0.80, -0.70, -0.35, 0.1, 0.45, 0.62, 0.75, 0.90, 1.02),
        half_width_m=(0.10, 0.20, 0.23, 0.22, 0.23, 0.16, 0.17, 0.14, 0.07),
        back_height_m=0.95,
        legs=(-0.50, 0.42, 0.20, 0.075, _TIGER),
        stride_m=1.2,
        tail=(0.85, 0.05, _TIGER, _BLACK),
        ears=(0.72, 0.14, 0.05, _BLACK),
    ),
    "zebra": Species(
        coat=_zebra,
        outline_x_m=(-0.95, -0.82, -0.5, -0.1, 0.25, 0.50, 0.70, 0.92, 1.08, 1.25, 1.32),
        half_width_m=(0.12, 0.26, 0.30, 0.28, 0.28, 0.19, 0.12, 0.10, 0.11, 0.07, 0.05),
        back_height_m=1.35,
        legs=(-0.65, 0.38, 0.22, 0.055, _PALE),
        stride_m=1.5,
        tail=(0.38, 0.04, _WHITE, _BLACK),
        ears=(0.98, 0.09, 0.05, _BLACK),
    ),
}
