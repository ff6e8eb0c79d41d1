"""The vehicles of the simulated world from above, as large as life."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dronemon.types import Vector3
from sim.painting import SPRITE_PX_PER_M, Canvas, Layer

# Colours are BGR, 0 to 1.
_BLACK = (0.08, 0.08, 0.08)
_BLUE = (0.70, 0.28, 0.08)
_RED = (0.12, 0.09, 0.74)
_WHITE = (0.92, 0.93, 0.92)
_YELLOW = (0.06, 0.80, 0.95)
_GLASS = (0.17, 0.14, 0.12)
_BED = (0.30, 0.29, 0.28)
_SIDES = 0.6
"""Brightness of the sides over that of the roof."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """A box on wheels, drawn at the height of its roof, with its sides below."""

    colour: Vector3
    length_m: float
    half_breadth_m: float
    top_m: float
    glass: tuple[tuple[float, float, float], ...]
    """Panes: from x to x, half their width in m."""
    gap_x_m: tuple[float, float] | None = None
    """From x to x, what lies open between cab and load."""
    scale: float = 1.0
    px_per_m: float = SPRITE_PX_PER_M
    centre_x_m: float = 0.0
    stride_m: float = 1.0
    num_phases: int = 1
    """Nothing on it moves as it goes."""

    @property
    def half_length_m(self) -> float:
        """From the centre to the bumper."""
        return 0.5 * self.length_m

    def paint(self, canvas: Canvas, _phase: float) -> tuple[Layer, Layer]:
        """Its sides, and its roof, hood and panes."""
        ends = (-self.half_length_m, self.half_length_m)
        hull = canvas.box(ends, self.half_breadth_m, 0.25)
        sides, roof = Layer(canvas), Layer(canvas)
        sides.paint(hull, _SIDES * np.array(self.colour))
        roof.paint(hull, self.colour)
        for low_m, high_m, half_width_m in self.glass:
            roof.paint(canvas.box((low_m, high_m), half_width_m, 0.1), _GLASS)
        if self.gap_x_m is not None:
            roof.paint(canvas.box(self.gap_x_m, self.half_breadth_m, 0.0), _BED)
        return sides, roof


def _car(colour: Vector3) -> Vehicle:
    """A compact car: windscreen and rear window aslant, so that they show from above."""
    panes = ((0.25, 0.90, 0.68), (-1.85, -1.40, 0.66))
    return Vehicle(colour=colour, length_m=4.3, half_breadth_m=0.9, top_m=1.1, glass=panes)


def _van(colour: Vector3) -> Vehicle:
    """A panel van, whose only panes are in front."""
    panes = ((1.75, 2.30, 0.85),)
    return Vehicle(colour=colour, length_m=5.9, half_breadth_m=1.0, top_m=2.4, glass=panes)


def _truck(colour: Vector3) -> Vehicle:
    """A lorry of three axles: cab, gap and box."""
    panes, gap = ((4.85, 5.10, 1.05),), (2.95, 3.35)
    return Vehicle(
        colour=colour, length_m=10.5, half_breadth_m=1.25, top_m=3.2, glass=panes, gap_x_m=gap
    )


def _bus(colour: Vector3) -> Vehicle:
    """A city bus with hatches in its roof."""
    panes = ((5.60, 5.90, 1.10), (2.30, 3.10, 0.40), (-3.10, -2.30, 0.40))
    return Vehicle(colour=colour, length_m=12.0, half_breadth_m=1.275, top_m=2.9, glass=panes)


VEHICLES: dict[str, Vehicle] = {
    "bus-red": _bus(_RED),
    "bus-yellow": _bus(_YELLOW),
    "car-black": _car(_BLACK),
    "car-blue": _car(_BLUE),
    "car-red": _car(_RED),
    "car-white": _car(_WHITE),
    "car-yellow": _car(_YELLOW),
    "truck-blue": _truck(_BLUE),
    "truck-white": _truck(_WHITE),
    "van-blue": _van(_BLUE),
    "van-white": _van(_WHITE),
}
