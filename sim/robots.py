"""Ground robots of the simulated world from above, told apart by the marker on each one's roof."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from dronemon.errors import OptionError
from dronemon.types import FloatArray
from dronemon.vision.markers import dictionary_of, modules_of, number_of
from sim.painting import Canvas, Layer

_WHEELS = (0.10, 0.10, 0.11)
_PX_PER_MODULE = 8.0
_MARGIN = 0.25
"""Of white about a marker, and as much of the wheels, over its side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Robot:
    """A box on wheels, all roof, as large as its marker asks for.

    modules: (M, M) 0 to 1 the marker's brightness, its black border with it
    side_m:  of the marker
    """

    modules: FloatArray
    side_m: float
    scale: float = 1.0
    centre_x_m: float = 0.0
    stride_m: float = 1.0
    num_phases: int = 1

    @classmethod
    def of(cls, look: str) -> Self:
        """The robot of a look, as `look_of` makes them. Raises OptionError for a strange one."""
        parts = look.split("/")
        if len(parts) != len(("family", "number", "side_m")):
            raise OptionError(f"the simulator draws no {look!r}")
        family, number, side_m = parts
        dictionary = dictionary_of(family)
        count = modules_of(dictionary)
        marker = cv2.aruco.generateImageMarker(dictionary, number_of(number, family), count)
        return cls(modules=marker.astype(np.float64) / 255.0, side_m=float(side_m))

    @property
    def px_per_m(self) -> float:
        """So that its modules are sharp, however large it is."""
        return _PX_PER_MODULE * len(self.modules) / self.side_m

    @property
    def half_length_m(self) -> float:
        """From the centre to the bumper."""
        return (0.5 + _MARGIN) * self.side_m

    @property
    def half_breadth_m(self) -> float:
        """From the centre to the outer side of a wheel."""
        return (0.5 + 2.0 * _MARGIN) * self.side_m

    @property
    def top_m(self) -> float:
        """Height of the roof."""
        return 0.25 * self.side_m

    def paint(self, canvas: Canvas, _phase: float) -> tuple[Layer, Layer]:
        """Its wheels, and its roof with the marker."""
        wheels, roof = Layer(canvas), Layer(canvas)
        end_m, round_m = self.half_length_m, 0.1 * self.side_m
        for from_m, to_m in ((-end_m, -0.3 * end_m), (0.3 * end_m, end_m)):
            wheels.paint(canvas.box((from_m, to_m), self.half_breadth_m, round_m), _WHEELS)
        roof.paint(canvas.box((-end_m, end_m), end_m, 0.0), (1.0, 1.0, 1.0))
        half_m, count = 0.5 * self.side_m, len(self.modules)
        column, row = (
            np.clip((at_m + half_m) / self.side_m * count, 0, count - 1).astype(int)
            for at_m in (canvas.x, canvas.y)
        )
        roof.paint(canvas.box((-half_m, half_m), half_m, 0.0), self.modules[row, column, None])
        return wheels, roof


def look_of(family: str, number: str, side_m: float) -> str:
    """What a robot with such a marker looks like, as one word."""
    return f"{family}/{number}/{side_m:g}"
