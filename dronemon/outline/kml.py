"""KML, as Google Earth writes it: placemarks with polygons, longitude before latitude.

Source: OGC KML 2.2.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from xml.etree.ElementTree import Element

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import ParseError, fromstring

from dronemon.outline.feature import (
    Feature,
    Flaw,
    Polygon,
    blamed_on,
    plain_name,
    zone_marks,
)
from dronemon.outline.rings import polygon_in_degrees

_ON_THE_GROUND = {"clampToGround", "clampToSeaFloor"}
"""Modes in which a height that is written does not count; the first one is the default."""
_MAX_DEPTH = 50


def kml_features(text: str) -> list[Feature]:
    """Every placemark of a file. Raises Flaw."""
    try:
        root = fromstring(text, forbid_dtd=True)
    except ParseError as exc:
        raise Flaw(f"not valid XML: {exc}; is the file complete?") from exc
    except DefusedXmlException as exc:
        raise Flaw("has a DOCTYPE or entities, which no KML needs and which are not read") from exc
    if _tag(root) != "kml":
        raise Flaw(f"not KML: it begins with <{_tag(root)}>, not <kml>")
    _refuse_depth(root)
    return [_feature(n, mark) for n, mark in enumerate(_marks(root), start=1)]


def _feature(number: int, mark: Element) -> Feature:
    name = plain_name(_text(mark, "name"))
    label = f"Placemark {number}, {name!r}" if name else f"Placemark {number}"
    with blamed_on(label):
        is_zone, below_m, height_m = zone_marks(name, partial(_property, mark))
        return Feature(
            label=label,
            name=name,
            is_no_fly=is_zone,
            polygons=tuple(map(_polygon, _all(mark, "Polygon"))),
            below_m=below_m,
            height_m=height_m,
        )


def _property(mark: Element, name: str) -> str | None:
    """What its ExtendedData, typed or not, has under a name."""
    for data in (*_all(mark, "Data"), *_all(mark, "SimpleData")):
        if data.get("name", "").lower() == name:
            return _text(data, "value") or data.text
    return None


def _polygon(polygon: Element) -> Polygon:
    mode = (_text(polygon, "altitudeMode") or "clampToGround").strip()
    outer, inner = (list(_all(polygon, f"{side}BoundaryIs")) for side in ("outer", "inner"))
    if len(outer) != 1:
        raise Flaw(f"is a polygon with {len(outer)} outer boundaries, not 1")
    rings = [" ".join(c.text or "" for c in _all(ring, "coordinates")) for ring in outer + inner]
    return polygon_in_degrees((_lat_lon(word, mode) for word in ring.split()) for ring in rings)


def _lat_lon(word: str, mode: str) -> list[float]:
    try:
        longitude, latitude, *height = map(float, word.split(","))
    except ValueError as exc:
        raise Flaw(f"{word[:60]!r} is not longitude,latitude or longitude,latitude,height") from exc
    if len(height) > 1:
        raise Flaw(f"{word[:60]!r} has more numbers than longitude, latitude and height")
    return [latitude, longitude, *(() if mode in _ON_THE_GROUND else height)]


def _refuse_depth(root: Element) -> None:
    """Nobody needs depth, and to look through each element of it for others takes hours."""
    level = [root]
    for _ in range(_MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise Flaw("nested too deeply")


def _marks(holder: Element) -> Iterator[Element]:
    """All placemarks in something; what one of them holds is its own."""
    for child in holder:
        if _tag(child) == "Placemark":
            yield child
        else:
            yield from _marks(child)


def _all(holder: Element, tag: str) -> Iterator[Element]:
    """Elements at any depth, of whatever namespace: old files have others than OGC's, or none."""
    return (element for element in holder.iter() if _tag(element) == tag)


def _text(holder: Element, tag: str) -> str | None:
    """Text of the first child of a name."""
    return next((child.text for child in holder if _tag(child) == tag), None)


def _tag(element: Element) -> str:
    return str(element.tag).rpartition("}")[2]
