"""The people of the simulated world from above, as large as life: who is who tells the jacket."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dronemon.types import Vector3
from sim.painting import NUM_PHASES, SPRITE_PX_PER_M, Canvas, Layer

# Colours are BGR, 0 to 1.
_HAIR = (0.10, 0.15, 0.22)
_SKIN = (0.50, 0.62, 0.82)
_TROUSERS = (0.13, 0.12, 0.11)
_SHADED = 0.8
"""Brightness of sleeves, which are lower and turned away, over that of shoulders."""
_SHOULDER_M, _ARM_M, _LEG_M, _HEAD_M = 0.12, 0.06, 0.08, 0.095
"""Radii: half the depth of the shoulders, then of a sleeve, of a trouser leg and of a head."""
_REACH_M = 0.25
"""How far a foot or a hand swings to the fore and to the rear."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Person:
    """An adult who walks, half a metre across the shoulders."""

    jacket: Vector3
    scale: float = 1.0
    px_per_m: float = SPRITE_PX_PER_M
    centre_x_m: float = 0.0
    half_length_m: float = _REACH_M + _LEG_M
    half_breadth_m: float = 0.30
    top_m: float = 1.35
    stride_m: float = 1.4
    num_phases: int = NUM_PHASES

    def paint(self, canvas: Canvas, phase: float) -> tuple[Layer, Layer]:
        """Legs, and all above them, in one phase of a stride."""
        swing_m = _REACH_M * math.sin(2.0 * math.pi * phase)
        legs, body = Layer(canvas), Layer(canvas)
        sleeve = _SHADED * np.array(self.jacket)
        for side in (-1.0, 1.0):
            hip, foot = (0.0, 0.09 * side), (side * swing_m + 1e-3, 0.09 * side)
            legs.paint(canvas.capsule(hip, foot, _LEG_M), _TROUSERS)
            shoulder, hand = (0.0, 0.20 * side), (-0.6 * side * swing_m, 0.24 * side)
            body.paint(canvas.disc(*hand, 0.05), _SKIN)
            wrist = (0.8 * hand[0], 0.235 * side)
            body.paint(canvas.capsule(shoulder, wrist, _ARM_M), sleeve)
        body.paint(canvas.capsule((0.0, -0.13), (0.0, 0.13), _SHOULDER_M), self.jacket)
        body.paint(canvas.disc(0.03, 0.0, _HEAD_M), _HAIR)
        return legs, body


PEOPLE: dict[str, Person] = {
    "person-blue": Person(jacket=(0.85, 0.42, 0.12)),
    "person-orange": Person(jacket=(0.08, 0.45, 0.98)),
    "person-pink": Person(jacket=(0.72, 0.20, 0.95)),
    "person-red": Person(jacket=(0.14, 0.10, 0.80)),
    "person-yellow": Person(jacket=(0.10, 0.88, 0.92)),
}
