"""Where the agent and the targets may be. For now the unit square, and only this file knows that.

Everyone else asks `ARENA`, or the arena that a planner's briefing carries. Its compiled twin for
the search is in `dronemon.planner.moving`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dronemon.types import BoolArray, FloatArray

ROUNDING_AU = 1e-9
"""A place this far outside counts as on the border."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arena:
    """A rectangle along the axes, its border included.

    low_au:  (x, y) au its corner of least x and y
    high_au: (x, y) au the corner opposite
    """

    low_au: tuple[float, float] = (0.0, 0.0)
    high_au: tuple[float, float] = (1.0, 1.0)

    @property
    def bounds(self) -> FloatArray:
        """What compiled code is given. -> (2, 2) float64 au, low and high corner."""
        return np.array([self.low_au, self.high_au])

    @property
    def outline_au(self) -> FloatArray:
        """Its corners, as a walk around it that ends where it began. -> (5, 2) float64 au."""
        (left, bottom), (right, top) = self.low_au, self.high_au
        around = [(left, bottom), (right, bottom), (right, top), (left, top), (left, bottom)]
        return np.array(around)

    @property
    def extent_au(self) -> FloatArray:
        """Width and height. -> (2,) float64 au."""
        low, high = self.bounds
        extent: FloatArray = high - low
        return extent

    def contains(self, places_au: FloatArray) -> BoolArray:
        """Tell which places are inside or on the border; none that is not finite.

        places_au: (..., 2) float64 au
        -> (...) bool
        """
        low, high = self.bounds
        inside = (places_au >= low - ROUNDING_AU) & (places_au <= high + ROUNDING_AU)
        every: BoolArray = inside.all(axis=-1)
        return every

    def clip(self, places_au: FloatArray, margin_au: float = 0.0) -> FloatArray:
        """Nearest places that are inside, and at least a margin from the border; NaN stays NaN.

        places_au: (..., 2) float64 au
        -> (..., 2) float64 au
        """
        low, high = self.bounds
        clipped: FloatArray = np.clip(places_au, low + margin_au, high - margin_au)
        return clipped

    def segment_is_free(self, start_au: FloatArray, end_au: FloatArray) -> bool:
        """Whether one can fly straight from one place to another. start_au, end_au: (2,) au."""
        return bool(self.contains(start_au) and self.contains(end_au))  # it is convex

    def places(self, shares: FloatArray) -> FloatArray:
        """Spread even draws evenly over the area. shares: (..., 2) in [0, 1) -> (..., 2) au."""
        low, _ = self.bounds
        places: FloatArray = low + self.extent_au * shares
        return places

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw places evenly over the area. -> (count, 2) float64 au."""
        return self.places(rng.random((count, 2)))

    def axes(self, size: int) -> FloatArray:
        """Coordinates of a regular grid, both borders included. -> (2, size) float64 au x, y."""
        low, high = self.bounds
        axes: FloatArray = np.linspace(low, high, size, axis=1)
        return axes

    def grid(self, size: int) -> FloatArray:
        """Points of that grid, y changing fastest. -> (size * size, 2) float64 au."""
        return _product(self.axes(size))

    def cells(self, size: int) -> FloatArray:
        """Centres of size * size equal cells, y changing fastest. -> (size * size, 2) au."""
        shares = (np.arange(size) + 0.5) / size
        return self.places(_product(np.stack([shares, shares])))


def _product(axes: FloatArray) -> FloatArray:
    """Every pair of coordinates. axes: (2, size) -> (size * size, 2)."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


ARENA = Arena()
"""The paper's square."""
