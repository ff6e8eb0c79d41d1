"""Sprites of all that lives and drives in the simulated world: each drawn once, from above."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Protocol

from dronemon.types import APPEARANCES, ImageArray
from sim.painting import Canvas, Layer
from sim.people import PEOPLE
from sim.robots import Robot
from sim.species import SPECIES
from sim.vehicles import VEHICLES


class Figure(Protocol):
    """Something that can be drawn from above; lengths in real metres."""

    @property
    def scale(self) -> float:
        """Drawn length over real length."""

    @property
    def px_per_m(self) -> float:
        """Finest resolution of its sprites, in pixels per drawn metre."""

    @property
    def centre_x_m(self) -> float:
        """Centre of its area; the x origin may be anywhere."""

    @property
    def half_length_m(self) -> float:
        """From the centre to whichever end is further."""

    @property
    def half_breadth_m(self) -> float:
        """Half of its greatest width."""

    @property
    def top_m(self) -> float:
        """Height of the plane that its upper part is drawn in."""

    @property
    def stride_m(self) -> float:
        """Ground covered in one stride."""

    @property
    def num_phases(self) -> int:
        """Pictures of one stride."""

    def paint(self, canvas: Canvas, phase: float) -> tuple[Layer, Layer]:
        """Its lower and its upper part, in one phase of a stride (0 to 1)."""


_FIGURES: Mapping[str, Figure] = {**SPECIES, **PEOPLE, **VEHICLES}
assert set(_FIGURES) == set(APPEARANCES)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sprite:
    """A figure in one phase of its stride, seen from above, its nose towards column infinity.

    lower, upper: (rows, columns, 4) uint8 BGRA, premultiplied by alpha, at px_per_m and at each
    half of it. The figure's centre is the sprite's; a row further down is further right.
    """

    lower: tuple[ImageArray, ...]
    upper: tuple[ImageArray, ...]
    top_m: float
    px_per_m: float


@cache
def _figure(appearance: str) -> Figure:
    return _FIGURES[appearance] if appearance in _FIGURES else Robot.of(appearance)


@cache
def draw_sprites(appearance: str) -> tuple[Sprite, ...]:
    """The sprites of one stride."""
    figure = _figure(appearance)
    px_per_unit = figure.px_per_m * figure.scale
    canvas = Canvas.around(
        figure.centre_x_m, figure.half_length_m, figure.half_breadth_m, px_per_unit
    )
    top_m = figure.top_m * figure.scale
    phases = [i / figure.num_phases for i in range(figure.num_phases)]
    parts = [figure.paint(canvas, phase) for phase in phases]
    return tuple(
        Sprite(lower=lower.images(), upper=upper.images(), top_m=top_m, px_per_m=figure.px_per_m)
        for lower, upper in parts
    )


def stride_m(appearance: str) -> float:
    """Ground covered in one stride, as drawn."""
    return _figure(appearance).stride_m * _figure(appearance).scale


def drawn_size_m(appearance: str) -> tuple[float, float, float]:
    """Length, width and height of the upper part, as drawn."""
    figure = _figure(appearance)
    sizes_m = 2.0 * figure.half_length_m, 2.0 * figure.half_breadth_m, figure.top_m
    length_m, width_m, height_m = (size_m * figure.scale for size_m in sizes_m)
    return length_m, width_m, height_m
