"""A polygon, perhaps with holes, and what is asked of it: is it there, how near, draw there."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

import numpy as np
import shapely
from shapely import GeometryType, Polygon
from shapely.geometry.base import BaseGeometry

from dronemon.types import BoolArray, FloatArray

ROUNDING_AU = 1e-9
"""A place this far outside counts as on the border."""


class Region:
    """One polygon, its border included."""

    def __init__(self, shape: Polygon) -> None:
        self.shape: Polygon = shapely.orient_polygons(shape)  # inside is left of every ring
        self._generous = shape.buffer(ROUNDING_AU, join_style="mitre")
        shapely.prepare([self.shape, self._generous])

    @property
    def area_au2(self) -> float:
        """How large it is."""
        return float(self.shape.area)

    def contains(self, places_au: FloatArray) -> BoolArray:
        """Tell which places are inside or on the border; none that is not finite. (..., 2)."""
        places_au = np.asarray(places_au, dtype=np.float64)
        return np.asarray(shapely.intersects_xy(self._generous, *np.moveaxis(places_au, -1, 0)))

    def is_free(self, starts_au: FloatArray, ends_au: FloatArray) -> BoolArray:
        """Tell which straight lines stay inside. (..., 2), (..., 2) au -> (...) bool."""
        starts_au, ends_au = np.broadcast_arrays(starts_au, ends_au)
        lines = shapely.linestrings(np.stack([starts_au, ends_au], axis=-2))
        return np.asarray(shapely.covers(self._generous, lines))

    def holds(self, polygons_au: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Which polygons are wholly inside, and which wholly outside. (k, n, 2) -> (k,), (k,)."""
        polygons = shapely.polygons(polygons_au)
        is_in = shapely.contains_properly(self.shape, polygons)
        return np.asarray(is_in), np.asarray(shapely.disjoint(self.shape, polygons))

    def clip(self, places_au: FloatArray) -> FloatArray:
        """Nearest places that are inside; NaN stays NaN. (..., 2) -> (..., 2) au."""
        clipped = np.array(places_au, dtype=np.float64)
        is_out = np.isfinite(clipped).all(axis=-1) & ~self.contains(clipped)
        nearest = shapely.shortest_line(self.shape, shapely.points(clipped[is_out]))
        clipped[is_out] = shapely.get_coordinates(shapely.get_point(nearest, 0))
        return clipped

    def largest_circle(self) -> tuple[FloatArray, float]:
        """Centre (2,) au and radius of the largest circle inside, to a thousandth or so."""
        radius = shapely.maximum_inscribed_circle(self.shape)
        return shapely.get_coordinates(radius)[0], float(shapely.length(radius))

    def chords(self, lines_au: FloatArray) -> FloatArray:
        """Parts of straight lines that are inside, start and end each. (k, 2, 2) -> (m, 2, 2)."""
        inside = shapely.intersection(self.shape, shapely.linestrings(lines_au))
        parts = shapely.get_parts(inside)
        parts = parts[shapely.get_type_id(parts) == GeometryType.LINESTRING]
        ends = [shapely.get_coordinates(shapely.get_point(parts, at)) for at in (0, -1)]
        return np.stack(ends, axis=1)

    def missed(self, lines_au: FloatArray, distance_au: float) -> FloatArray:
        """Places inside so that none is farther from both lines and places than a distance.

        lines_au: (k, 2, 2) au start and end of each -> (m, 2) au, none where lines are enough
        """
        places = [np.empty((0, 2))]
        rest: BaseGeometry = self.shape
        new = np.asarray(shapely.linestrings(lines_au))
        while len(new):
            # One by one: around a line that turns back on itself shapely forgets the end of it.
            rest = rest.difference(shapely.union_all(shapely.buffer(new, distance_au)))
            new = np.asarray(shapely.point_on_surface(shapely.get_parts(rest)))
            new = new[~shapely.is_empty(new)]
            places.append(shapely.get_coordinates(new))
        return np.concatenate(places)

    def shrunk(self, margin_au: float) -> Region | None:
        """What is so far inside, the largest part of it; None if there is none."""
        return next(iter(self.parts(margin_au)), None)

    def parts(self, margin_au: float, without: Iterable[Polygon] = ()) -> list[Region]:
        """What is left a margin away from the border and from other polygons, largest first."""

        def buffered(shape: Polygon, distance_au: float) -> BaseGeometry:
            return shape.buffer(distance_au, join_style="mitre", mitre_limit=2.0)

        taken = shapely.union_all([buffered(other, margin_au) for other in without])
        left = buffered(self.shape, -margin_au).difference(taken)
        parts = [p for p in shapely.get_parts(left) if p.geom_type == "Polygon" and not p.is_empty]
        return [Region(part) for part in sorted(parts, key=shapely.area, reverse=True)]

    @cached_property
    def _triangles(self) -> tuple[FloatArray, FloatArray]:
        """Its triangles (K, 3, 2) au, and the share of the area before each (K + 1,)."""
        parts = shapely.get_parts(shapely.constrained_delaunay_triangles(self.shape))
        corners = np.stack([shapely.get_coordinates(part)[:3] for part in parts])
        before = np.concatenate([[0.0], np.cumsum(shapely.area(parts))])
        return corners, before / before[-1]

    def places(self, shares: FloatArray) -> FloatArray:
        """Spread even draws evenly over it. shares: (..., 2) in [0, 1) -> (..., 2) au."""
        corners, before = self._triangles
        which = np.searchsorted(before, shares[..., 0], side="right") - 1
        along = (shares[..., 0] - before[which]) / (before[which + 1] - before[which])
        a, b, c = np.moveaxis(corners[which], -2, 0)
        out, across = np.sqrt(along)[..., None], shares[..., 1, None]
        places: FloatArray = (1.0 - out) * a + out * ((1.0 - across) * b + across * c)
        return places

    @property
    def rings(self) -> list[FloatArray]:
        """Its border and those of its holes, (n, 2) au each, not closed, inside to the left."""
        rings = (self.shape.exterior, *self.shape.interiors)
        return [shapely.get_coordinates(ring)[:-1] for ring in rings]

    @property
    def edges(self) -> FloatArray:
        """(E, 4) au: x and y of the start and of the end of each edge."""
        return np.concatenate([np.hstack([r, np.roll(r, -1, axis=0)]) for r in self.rings])
