"""Where the agent and the targets may be. Nobody else knows of which form that is.

Everyone else asks the arena that an instance, a briefing or a laid area carries. Its compiled twin
for the search is in `dronemon.planner.moving`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from shapely import Polygon

from dronemon.arena.region import ROUNDING_AU, Region
from dronemon.arena.ways import CLEAR_AU, Ways
from dronemon.types import BoolArray, FloatArray

Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True)
class Arena:
    """A rectangle along the axes, or a polygon with no-fly zones; borders are included.

    Targets may be anywhere in it. The agent keeps a margin from its border, and out of no-fly
    zones by the same margin.

    low_au:    (x, y) au its corner of least x and y, of a polygon that of the box around it
    high_au:   (x, y) au the corner opposite
    border_au: corners of the polygon in order, not closed; none of a rectangle
    no_fly_au: those of each zone
    margin_au: of the agent, in a polygon
    """

    low_au: tuple[float, float] = (0.0, 0.0)
    high_au: tuple[float, float] = (1.0, 1.0)
    border_au: Corners = ()
    no_fly_au: tuple[Corners, ...] = ()
    margin_au: float = 0.0

    @classmethod
    def polygon(
        cls,
        border_au: FloatArray,
        no_fly_au: Sequence[FloatArray] = (),
        *,
        margin_au: float = 0.0,
    ) -> Arena:
        """Inside of a border, without zones. border_au: (n, 2); no_fly_au: (m, 2) each.

        ValueError where it leaves the agent nothing, or the border crosses itself.
        """
        return _polygon(_corners(border_au), tuple(map(_corners, no_fly_au)), margin_au)

    @classmethod
    def told(cls, values: Mapping[str, Any]) -> Arena:
        """Read what `dataclasses.asdict` made of one, and JSON of that."""
        tuples = {key: _tupled(value) for key, value in values.items()}
        return cls(**tuples)

    @property
    def is_rectangle(self) -> bool:
        """Whether it is one along the axes, in all of which the agent may be."""
        return not self.border_au

    @cached_property
    def field(self) -> Region:
        """Where targets may be."""
        return Region(Polygon(self.border_au or self.outline_au))

    @cached_property
    def _parts(self) -> list[Region]:
        return self.field.parts(self.margin_au, map(Polygon, self.no_fly_au))

    @property
    def free(self) -> Region:
        """Where the agent may be: one part, the largest. ValueError where there is none."""
        if not self._parts:
            raise ValueError(
                f"no-fly zones and a margin of {self.margin_au:.3g} au leave nothing to fly in"
            )
        return self._parts[0]

    @property
    def cut_off(self) -> float:
        """Share of where the agent might be that no way leads to from there."""
        return 1.0 - self.free.area_au2 / sum(part.area_au2 for part in self._parts)

    @cached_property
    def goals(self) -> Region:
        """Where search puts goals: a little off the edges, or a way between two might cross one."""
        return self.free.shrunk(CLEAR_AU / 2.0) or self.free

    @cached_property
    def ways(self) -> Ways:
        """The agent's ways about it."""
        return Ways(self.free)

    @cached_property
    def field_ways(self) -> Ways:
        """Targets' ways about it."""
        return Ways(self.field)

    @property
    def bounds(self) -> FloatArray:
        """The box around it. -> (2, 2) float64 au, low and high corner."""
        return np.array([self.low_au, self.high_au])

    @property
    def box_au(self) -> FloatArray:
        """Corners of the box around it, from the low one on by that of most x. -> (4, 2) au."""
        (left, bottom), (right, top) = self.low_au, self.high_au
        return np.array([(left, bottom), (right, bottom), (right, top), (left, top)])

    @property
    def outline_au(self) -> FloatArray:
        """Its corners, as a walk around it that ends where it began. -> (n + 1, 2) float64 au."""
        around = np.array(self.border_au) if self.border_au else self.box_au
        return np.concatenate([around, around[:1]])

    @property
    def zones_au(self) -> list[FloatArray]:
        """Walks around each no-fly zone, like that of the outline. -> (m + 1, 2) au each."""
        return [np.array([*zone, zone[0]]) for zone in self.no_fly_au]

    @property
    def extent_au(self) -> FloatArray:
        """Width and height of the box. -> (2,) float64 au."""
        low, high = self.bounds
        extent: FloatArray = high - low
        return extent

    def contains(self, places_au: FloatArray) -> BoolArray:
        """Tell which places are inside or on the border; none that is not finite.

        places_au: (..., 2) float64 au
        -> (...) bool
        """
        if not self.is_rectangle:
            return self.field.contains(places_au)
        low, high = self.bounds
        inside = (places_au >= low - ROUNDING_AU) & (places_au <= high + ROUNDING_AU)
        every: BoolArray = inside.all(axis=-1)
        return every

    def clip(self, places_au: FloatArray) -> FloatArray:
        """Nearest places that are inside; NaN stays NaN. (..., 2) -> (..., 2) float64 au."""
        if not self.is_rectangle:
            return self.field.clip(places_au)
        clipped: FloatArray = np.clip(places_au, *self.bounds)
        return clipped

    def clip_free(self, places_au: FloatArray, margin_au: float = 0.0) -> FloatArray:
        """Nearest places where the agent may be; NaN stays NaN.

        places_au: (..., 2) float64 au
        margin_au: to keep from where it may not be, if there is a place that can
        -> (..., 2) float64 au
        """
        if not self.is_rectangle:
            region = self.free.shrunk(margin_au) if margin_au else self.free
            return (region or self.free).clip(places_au)
        low, high = self.bounds
        clipped: FloatArray = np.clip(places_au, low + margin_au, high - margin_au)
        return clipped

    def segment_is_free(self, start_au: FloatArray, end_au: FloatArray) -> bool:
        """Whether one can fly straight from one place to another. start_au, end_au: (2,) au."""
        if not self.is_rectangle:
            return bool(self.free.is_free(start_au, end_au))
        return bool(self.contains(start_au) and self.contains(end_au))  # it is convex

    def way(self, start_au: FloatArray, end_au: FloatArray) -> FloatArray:
        """Shortest way there: places to fly to straight, the end last. (2,), (2,) -> (K, 2) au.

        From a place where the agent may not be, first to the nearest where it may; ValueError to
        one.
        """
        if self.is_rectangle:
            return np.asarray(end_au, dtype=np.float64)[None]
        begin_au = self.free.clip(start_au)
        way_au = self.ways.way(begin_au, end_au)
        is_there = bool(self.free.contains(start_au))
        return way_au if is_there else np.concatenate([begin_au[None], way_au])

    def distances(self, starts_au: FloatArray, ends_au: FloatArray) -> FloatArray:
        """Lengths of the shortest ways. (n, 2), (m, 2) au -> (n, m) au.

        Of a place where the agent may not be the nearest where it may counts.
        """
        starts_au, ends_au = self.clip_free(starts_au), self.clip_free(ends_au)
        if not self.is_rectangle:
            return self.ways.distances(starts_au, ends_au)
        lengths: FloatArray = np.linalg.norm(starts_au[:, None] - ends_au, axis=-1)
        return lengths

    def places(self, shares: FloatArray) -> FloatArray:
        """Spread even draws evenly over the area. shares: (..., 2) in [0, 1) -> (..., 2) au."""
        if not self.is_rectangle:
            return self.field.places(shares)
        low, _ = self.bounds
        places: FloatArray = low + self.extent_au * shares
        return places

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw places evenly over the area. -> (count, 2) float64 au."""
        return self.places(rng.random((count, 2)))

    def sample_free(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw places evenly over where the agent may be. -> (count, 2) float64 au."""
        shares = rng.random((count, 2))
        return self.places(shares) if self.is_rectangle else self.free.places(shares)

    def axes(self, size: int) -> FloatArray:
        """Coordinates of a regular grid over the box, both borders included. -> (2, size) au."""
        low, high = self.bounds
        axes: FloatArray = np.linspace(low, high, size, axis=1)
        return axes

    def grid(self, size: int) -> FloatArray:
        """Points of that grid, y changing fastest. -> (size * size, 2) float64 au."""
        return _product(*self.axes(size))

    def cells(self, columns: int, rows: int) -> FloatArray:
        """Centres of equal cells of the box, y changing fastest. -> (columns * rows, 2) au."""
        low, _ = self.bounds
        shares = _product(*((np.arange(size) + 0.5) / size for size in (columns, rows)))
        cells: FloatArray = low + self.extent_au * shares
        return cells


@lru_cache(maxsize=32)
def _polygon(border_au: Corners, no_fly_au: tuple[Corners, ...], margin_au: float) -> Arena:
    """One object for one field, however often it is read: what follows from it is found once."""
    if not Polygon(border_au).is_valid:
        raise ValueError("the border crosses itself")
    arena = Arena(
        low_au=_pair(np.min(border_au, axis=0)),
        high_au=_pair(np.max(border_au, axis=0)),
        border_au=border_au,
        no_fly_au=no_fly_au,
        margin_au=margin_au,
    )
    arena.free  # noqa: B018  # asked for now, so that nobody meets its error later
    return arena


def _product(x: FloatArray, y: FloatArray) -> FloatArray:
    """Every pair of coordinates. x: (m,), y: (n,) -> (m * n, 2)."""
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def _tupled(value: Any) -> Any:
    return tuple(map(_tupled, value)) if isinstance(value, list) else value


def _pair(place: FloatArray) -> tuple[float, float]:
    x, y = place.tolist()
    return x, y


def _corners(places: FloatArray) -> Corners:
    return tuple(map(_pair, np.asarray(places, dtype=np.float64)))


ARENA = Arena()
"""The paper's square."""
