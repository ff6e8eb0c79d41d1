"""What the detector knows about animals and ground: colours, sizes and coats, seen from above.

The sizes are those of real animals; ENLARGEMENT says how much larger the simulated ones are drawn.
`python benchmarks/vision.py --measure` prints the numbers of PROTOTYPES for the simulated animals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dronemon.types import FloatArray

ENLARGEMENT = 1.8
"""Size of the animals in the pictures over that of real ones."""

COAT_COLOURS = {
    "black": ((18, 18, 20), (60, 61, 63), (80, 82, 84)),
    "white": ((237, 245, 247), (204, 230, 240), (158, 168, 173)),
    "orange": ((26, 94, 224), (31, 128, 245)),
    "tan": ((76, 128, 184),),
    "brown": ((23, 43, 92),),
}
"""BGR, 0 to 255, in full light."""
COAT_SHADES = (0.72, 0.85, 1.0)

GROUND_COLOURS = {
    "lush grass": (46, 98, 74),
    "meadow": (62, 128, 104),
    "dry grass": (92, 150, 142),
    "soil": (92, 130, 152),
    "rut": (80, 112, 132),
    "bush": (38, 74, 46),
}
GROUND_SHADES = (0.4, 0.5, 0.65, 0.8, 1.0, 1.15)
"""Down to the shadow of an animal."""
STONE_COLOURS = {"stone": (138, 142, 146), "tape": (120, 140, 146)}
STONE_SHADES = (0.75, 1.0, 1.15)


@dataclass(frozen=True, slots=True)
class Prototype:
    """One kind of animal from above.

    length_m, width_m: four standard deviations of its area along and across its main axis.
    """

    length_m: float
    width_m: float
    coat: tuple[float, float, float, float, float]
    """Shares of the COAT_COLOURS, in their order."""
    bands: float
    """Sum of all changes of brightness along its axis over the largest one."""
    trunk_height_m: float

    @property
    def traits(self) -> FloatArray:
        """-> (8,) length and width in m as drawn, five coat shares, bands"""
        size_m = np.array([self.length_m, self.width_m]) * ENLARGEMENT
        return np.concatenate([size_m, self.coat, [self.bands]])

    @property
    def spreads(self) -> FloatArray:
        """-> (8,) standard deviations of the traits between pictures"""
        size_m = np.array([0.07 * self.length_m, 0.17 * self.width_m]) * ENLARGEMENT
        return np.concatenate([size_m, np.full(5, 0.07), [0.3 + 0.15 * self.bands]])


# Length and width in m; shares of black, white, orange, tan, brown; bands; trunk's height in m.
PROTOTYPES = {
    "cow": Prototype(2.19, 0.78, (0.41, 0.59, 0.00, 0.00, 0.00), 3.5, 0.91),
    "deer": Prototype(1.79, 0.46, (0.00, 0.13, 0.00, 0.87, 0.00), 1.6, 0.65),
    "fox": Prototype(1.35, 0.33, (0.00, 0.10, 0.61, 0.26, 0.03), 1.6, 0.29),
    "horse": Prototype(2.45, 0.65, (0.05, 0.00, 0.00, 0.01, 0.94), 1.4, 1.00),
    "panda": Prototype(1.75, 0.93, (0.31, 0.69, 0.00, 0.00, 0.00), 2.4, 0.49),
    "sheep": Prototype(1.38, 0.60, (0.07, 0.93, 0.00, 0.00, 0.00), 1.3, 0.52),
    "tiger": Prototype(2.32, 0.72, (0.00, 0.00, 0.61, 0.38, 0.01), 6.0, 0.62),
    "zebra": Prototype(2.15, 0.58, (0.41, 0.59, 0.00, 0.00, 0.00), 10.9, 0.88),
}
