"""From a user's file to an outline, or to an error that names the file and what in it is wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import shapely

from dronemon.errors import MissionFileError
from dronemon.frames import GeoPoint
from dronemon.outline.feature import Feature, Flaw, Polygon
from dronemon.outline.geojson import geojson_features
from dronemon.outline.kml import kml_features
from dronemon.outline.outline import Outline, Zone
from dronemon.outline.plan import plan_features
from dronemon.outline.rings import FARTHEST_M, away_m, unwound

_MAX_BYTES = 2_000_000
_READERS: dict[str, Callable[[str], list[Feature]]] = {
    ".kml": kml_features,
    ".geojson": geojson_features,
    ".json": geojson_features,
    ".plan": plan_features,
}
_HOW_TO_MARK = (
    'begin its name with "no-fly", or give it the property no_fly: true; in a plan, make it an '
    "exclusion"
)


def read_outline(path: Path | str) -> Outline:
    """The outline that a KML, a GeoJSON or a QGroundControl plan has.

    No-fly are fences of exclusion, holes of the field, and features that are called or marked so;
    the one other polygon is the field. A no-fly zone's own holes are no-fly too.

    Raises MissionFileError.
    """
    path = Path(path)
    if path.suffix.lower() not in _READERS:
        raise MissionFileError(
            f"{path}: {path.suffix or 'a file without ending'} is no outline; it is to be a .kml "
            "(a .kmz is a zip that has one), .geojson, or .plan of QGroundControl"
        )
    try:
        return _read(path.suffix.lower(), _text(path))
    except Flaw as flaw:
        raise MissionFileError(f"{path}: {flaw}") from flaw


@lru_cache(maxsize=4)
def _read(suffix: str, text: str) -> Outline:
    """A mission asks for its outline again and again. Raises Flaw."""
    return _outline(_READERS[suffix](text))


def _text(path: Path) -> str:
    if not path.is_file():
        raise Flaw("no such file; a path is relative to the mission file")
    try:
        with path.open("rb") as file:
            raw = file.read(_MAX_BYTES + 1)
    except OSError as exc:
        raise Flaw(f"cannot be read: {exc.strerror or exc}") from exc
    if len(raw) > _MAX_BYTES:
        raise Flaw(f"larger than {_MAX_BYTES // 10**6} MB; simplify the outline")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as exc:
        raise Flaw(f"is not UTF-8: byte {exc.start} is {raw[exc.start]:#04x}; save it so") from exc
    if not text.strip():
        raise Flaw("is empty")
    return text


def _outline(features: list[Feature]) -> Outline:
    shown = [feature for feature in features if feature.polygons]
    fields = [feature for feature in shown if not feature.is_no_fly]
    for feature in features:
        if feature.is_no_fly and not feature.polygons:
            raise Flaw(
                f"{feature.label}: is no-fly, but no polygon; draw what is around it, or remove it"
            )
    if not shown:
        raise Flaw(
            f"has no polygon among its {len(features)} features; draw the field's border as a "
            "polygon, not as a line"
        )
    if not fields:
        raise Flaw("has no-fly zones only; add a polygon that is the field")
    if len(fields) > 1:
        raise Flaw(
            f"has {len(fields)} polygons that may be the field: "
            f"{'; '.join(field.label for field in fields[:5])}; leave one, and of one that is "
            f"no-fly {_HOW_TO_MARK}"
        )
    border, *holes = _in_one(fields[0])
    zones = [Zone(name="", corners_deg=hole) for hole in holes]
    zones += [zone for feature in shown if feature.is_no_fly for zone in _zones_of(feature)]
    outline = Outline(border_deg=unwound(border, 0.0), no_fly=tuple(_named(zones, border[0])))
    for zone in outline.no_fly:
        if (off_m := away_m(outline.border_deg, GeoPoint.at(zone.corners_deg[0]))) > FARTHEST_M:
            raise Flaw(
                f"{zone.name!r} is {off_m / 1000.0:.0f} km from the field; leave it out, or are "
                "its latitude and longitude swapped?"
            )
    if flaw := outline.laid(GeoPoint.at(border[0])).flaw():
        raise Flaw(flaw)
    return outline


def _zones_of(feature: Feature) -> Iterator[Zone]:
    """Each part of a no-fly feature."""
    for number, (ring, *_) in enumerate(feature.polygons, start=1):
        is_only = len(feature.polygons) == 1 or not feature.name
        name = feature.name if is_only else f"{feature.name} {number}"
        yield Zone(name=name, corners_deg=ring, below_m=feature.below_m, height_m=feature.height_m)


def _named(zones: list[Zone], near: tuple[float, float]) -> Iterator[Zone]:
    """Zones with longitudes near a place, numbered where they have no name."""
    number = 0
    for zone in zones:
        number += not zone.name
        name = zone.name or f"zone {number}"
        yield replace(zone, name=name, corners_deg=unwound(zone.corners_deg, near[1]))


def _in_one(field: Feature) -> Polygon:
    """A field's parts in one, as where RFC 7946 cuts it at 180 degrees. Raises Flaw."""
    first, *others = field.polygons
    if not others:
        return first
    near_deg = first[0][0][1]
    whole = shapely.union_all(
        [shapely.Polygon(unwound(border, near_deg)) for border, *_ in field.polygons]
    )
    if not isinstance(whole, shapely.Polygon):
        raise Flaw(
            f"{field.label}: is of {len(shapely.get_parts(whole))} polygons apart; leave one"
        )
    rings = (whole.exterior, *whole.interiors)
    holes = [hole for _, *others in field.polygons for hole in others]
    return (*(tuple((x, y) for x, y, *_ in ring.coords[:-1]) for ring in rings), *holes)
