"""What the detector knows about its targets and the ground: colours, sizes and coats from above.

All sizes are as drawn, which for animals is 1.8 times as large as life.
`python benchmarks/vision.py --measure` prints the numbers of PROTOTYPES.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dronemon.types import FloatArray

COAT_COLOURS = {
    "black": ((18, 18, 20), (60, 61, 63), (80, 82, 84)),
    "white": ((237, 245, 247), (204, 230, 240), (158, 168, 173)),
    "orange": ((26, 94, 224), (31, 128, 245)),
    "tan": ((76, 128, 184),),
    "brown": ((23, 43, 92),),
    "red": ((36, 26, 204), (31, 23, 189), (49, 72, 150)),
    "yellow": ((26, 224, 235), (15, 204, 242)),
    "blue": ((217, 107, 31), (178, 71, 20)),
    "pink": ((184, 51, 242),),
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
    """One kind of target from above.

    length_m, width_m: four standard deviations of its area along and across its main axis
    coat:              shares of the COAT_COLOURS; 0 where not named
    bands:             sum of all changes of brightness along its axis over the largest one
    height_m:          of the plane that most of it is seen in
    varies:            standard deviations between pictures: of length and width, relative to
                       them, and of the shares
    """

    length_m: float
    width_m: float
    coat: Mapping[str, float]
    bands: float
    height_m: float
    varies: tuple[float, float, float] = (0.07, 0.17, 0.07)
    needed_px_per_m: float = 5.5
    """Size on the picture of a metre on the ground below which it is too often missed.

    Of animals in the footprint 100 % are found at 6, 97 % at 5.5, 91 % at 5, 79 % at 4.5; of people
    100 % at 10, 99 % at 9, 96 % at 8; of vehicles 100 % at 3, 99 % at 2.5: `python
    benchmarks/vision.py --of people --height-m H`, where the default camera has 320 / H.
    """

    @property
    def area_m2(self) -> float:
        """Of an ellipse of its length and width."""
        return 0.25 * np.pi * self.length_m * self.width_m

    @property
    def traits(self) -> FloatArray:
        """-> (2 + colours + 1,) length and width in m, coat shares, bands"""
        coat = [self.coat.get(colour, 0.0) for colour in COAT_COLOURS]
        return np.array([self.length_m, self.width_m, *coat, self.bands])

    @property
    def spreads(self) -> FloatArray:
        """-> as traits: their standard deviations between pictures"""
        length, width, share = self.varies
        size_m = length * self.length_m, width * self.width_m
        return np.array([*size_m, *[share] * len(COAT_COLOURS), 0.3 + 0.15 * self.bands])


def _person(coat: Mapping[str, float]) -> Prototype:
    """A person, of whom the picture shows more or less of the dark trousers."""
    return Prototype(0.75, 0.38, coat, 1.4, 1.35, varies=(0.3, 0.25, 0.15), needed_px_per_m=9.0)


def _vehicle(
    length_m: float, width_m: float, coat: Mapping[str, float], bands: float, height_m: float
) -> Prototype:
    """A vehicle, of which the picture shows more or less of one side."""
    return Prototype(
        length_m, width_m, coat, bands, height_m, varies=(0.07, 0.25, 0.07), needed_px_per_m=3.0
    )


# Length and width in m, shares of colours, bands, height in m.
PROTOTYPES = {
    "cow": Prototype(3.94, 1.40, {"black": 0.41, "white": 0.59}, 3.5, 1.64),
    "deer": Prototype(3.22, 0.83, {"white": 0.13, "tan": 0.87}, 1.6, 1.17),
    "fox": Prototype(
        2.43, 0.59, {"white": 0.10, "orange": 0.61, "tan": 0.26, "brown": 0.03}, 1.6, 0.53
    ),
    "horse": Prototype(4.41, 1.17, {"black": 0.05, "tan": 0.01, "brown": 0.94}, 1.4, 1.81),
    "panda": Prototype(3.15, 1.67, {"black": 0.31, "white": 0.69}, 2.4, 0.88),
    "sheep": Prototype(2.48, 1.08, {"black": 0.07, "white": 0.93}, 1.3, 0.94),
    "tiger": Prototype(4.18, 1.30, {"orange": 0.61, "tan": 0.38, "brown": 0.01}, 6.0, 1.11),
    "zebra": Prototype(3.87, 1.04, {"black": 0.41, "white": 0.59}, 10.9, 1.58),
    "shadow": _person({"black": 1.0}),  # of a bush, which nobody watches
    "person-blue": _person({"black": 0.61, "blue": 0.36}),
    "person-orange": _person({"black": 0.14, "orange": 0.36, "tan": 0.41, "red": 0.03}),
    "person-pink": _person({"black": 0.36, "red": 0.14, "pink": 0.45}),
    "person-red": _person({"black": 0.10, "tan": 0.18, "brown": 0.05, "red": 0.61}),
    "person-yellow": _person({"black": 0.10, "tan": 0.02, "yellow": 0.80}),
    "bus-red": _vehicle(14.9, 3.9, {"black": 0.03, "brown": 0.03, "red": 0.93}, 2.4, 2.9),
    "bus-yellow": _vehicle(14.9, 3.8, {"black": 0.02, "yellow": 0.98}, 4.5, 2.9),
    "car-black": _vehicle(5.10, 2.26, {"black": 1.0}, 1.3, 1.1),
    "car-blue": _vehicle(5.3, 2.6, {"black": 0.19, "blue": 0.81}, 3.6, 1.1),
    "car-red": _vehicle(
        5.3, 2.5, {"black": 0.09, "tan": 0.04, "brown": 0.05, "red": 0.82}, 3.1, 1.1
    ),
    "car-white": _vehicle(5.2, 2.3, {"black": 0.13, "white": 0.87}, 4.4, 1.1),
    "car-yellow": _vehicle(5.2, 2.4, {"black": 0.07, "tan": 0.01, "yellow": 0.92}, 4.5, 1.1),
    "truck-blue": _vehicle(13.1, 4.5, {"black": 0.07, "blue": 0.93}, 1.7, 3.2),
    "truck-white": _vehicle(13.0, 3.9, {"black": 0.02, "white": 0.98}, 3.9, 3.2),
    "van-blue": _vehicle(7.5, 3.1, {"black": 0.11, "blue": 0.88}, 2.3, 2.4),
    "van-white": _vehicle(7.5, 2.9, {"black": 0.05, "white": 0.95}, 2.9, 2.4),
}
