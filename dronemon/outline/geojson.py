"""GeoJSON: features with polygons, longitude before latitude. Source: RFC 7946."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from dronemon.outline.feature import (
    Feature,
    Flaw,
    Polygon,
    blamed_on,
    plain_name,
    zone_marks,
)
from dronemon.outline.json_file import listed, mapped, numbers, parse_json
from dronemon.outline.rings import polygon_in_degrees

_DEGREES = re.compile(r"(CRS:?84|EPSG:(?:[\d.]*:)?4326)$", re.IGNORECASE)
_POINTS_AND_LINES = ("Point", "MultiPoint", "LineString", "MultiLineString")


def geojson_features(text: str) -> list[Feature]:
    """Every feature of a file. Raises Flaw."""
    root = parse_json(text)
    _refuse_projection(root)
    if root.get("type") == "FeatureCollection":
        entries = listed(root.get("features"), "features")
    elif root.get("type") == "Feature":
        entries = [root]
    else:
        entries = [{"type": "Feature", "geometry": root}]
    return [_feature(number, entry) for number, entry in enumerate(entries, start=1)]


def _feature(number: int, entry: object) -> Feature:
    with blamed_on(f"feature {number}"):
        feature = mapped(entry, "it")
        if feature.get("type") != "Feature":
            raise Flaw(f"its type is {feature.get('type')!r:.60}, not 'Feature'")
        _refuse_projection(feature)
        given = mapped(feature.get("properties") or {}, "properties")
        properties = {key.lower(): value for key, value in given.items()}
        name = plain_name(properties.get("name"))
    label = f"feature {number}, {name!r}" if name else f"feature {number}"
    with blamed_on(label):
        is_zone, below_m, height_m = zone_marks(name, properties.get)
        return Feature(
            label=label,
            name=name,
            is_no_fly=is_zone,
            polygons=tuple(_polygons(feature.get("geometry"))),
            below_m=below_m,
            height_m=height_m,
        )


def _polygons(given: object) -> Iterator[Polygon]:
    if given is None:  # a feature without a place
        return
    geometry = mapped(given, "geometry")
    _refuse_projection(geometry)
    kind, coordinates = geometry.get("type"), geometry.get("coordinates")
    if kind == "Polygon":
        yield _polygon(coordinates)
    elif kind == "MultiPolygon":
        for part in listed(coordinates, "coordinates"):
            yield _polygon(part)
    elif kind == "GeometryCollection":
        for part in listed(geometry.get("geometries"), "geometries"):
            yield from _polygons(part)
    elif kind not in _POINTS_AND_LINES:
        raise Flaw(f"{kind!r:.60} is no type of GeoJSON's; is it another kind of file?")


def _polygon(coordinates: object) -> Polygon:
    rings = [listed(ring, "a ring") for ring in listed(coordinates, "coordinates")]
    if not rings:
        raise Flaw("is a polygon without corners")
    return polygon_in_degrees(map(_lat_lon, ring) for ring in rings)


def _lat_lon(position: object) -> list[float]:
    longitude, latitude, *height = numbers(position, "a corner", (2, 3))
    return [latitude, longitude, *height]


def _refuse_projection(holder: dict[str, Any]) -> None:
    """Refuse what is not in WGS 84 degrees. Source: GeoJSON of 2008, section 3."""
    crs = holder.get("crs")
    if crs is None:
        return
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if not (isinstance(name, str) and _DEGREES.search(name)):
        raise Flaw(
            f"crs {name or crs!r:.80} is another projection; save it in degrees, WGS 84 (EPSG:4326)"
        )
