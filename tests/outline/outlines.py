"""Outlines as each format has them, written by these tests."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
RESERVE = {
    "kml": FOLDER / "reserve.kml",
    "geojson": FOLDER.parents[1] / "missions" / "reserve.geojson",
    "plan": FOLDER / "reserve.plan",
}
SQUARE = [(47.0, 8.0), (47.0, 8.01), (47.01, 8.01), (47.01, 8.0)]
INNER = [(47.002, 8.002), (47.002, 8.004), (47.004, 8.004)]
BOW_TIE = [(47.0, 8.0), (47.01, 8.01), (47.0, 8.01), (47.01, 8.0)]
Corners = Sequence[tuple[float, ...]]


def kml(*placemarks: str, head: str = '<kml xmlns="http://www.opengis.net/kml/2.2">') -> str:
    """A file of placemarks."""
    inside = f"<Document>{''.join(placemarks)}</Document>"
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{head}{inside}</kml>'


def placemark(*rings: Corners, name: str = "", more: str = "", inside: str = "") -> str:
    """A placemark with a polygon: its outer ring and holes. inside: of the polygon itself."""
    tags = ["outerBoundaryIs"] + ["innerBoundaryIs"] * (len(rings) - 1)
    boundaries = "".join(
        f"<{tag}><LinearRing><coordinates>{_tuples(ring)}</coordinates></LinearRing></{tag}>"
        for tag, ring in zip(tags, rings, strict=True)
    )
    named = f"<name>{name}</name>" if name else ""
    return f"<Placemark>{named}{more}<Polygon>{inside}{boundaries}</Polygon></Placemark>"


def _tuples(ring: Corners) -> str:
    closed = [*ring, *ring[:1]]
    return "\n".join(
        ",".join(repr(v) for v in (lon, lat, *(height or [0]))) for lat, lon, *height in closed
    )


def geojson(*features: dict[str, Any], **more: Any) -> str:
    """A FeatureCollection."""
    return json.dumps({"type": "FeatureCollection", **more, "features": list(features)})


def feature(*rings: Corners, **properties: Any) -> dict[str, Any]:
    """A feature with a polygon: its outer ring and holes."""
    return {"type": "Feature", "properties": properties, "geometry": polygon(*rings)}


def polygon(*rings: Corners) -> dict[str, Any]:
    """A polygon of GeoJSON."""
    coordinates = [
        [[lon, lat, *height] for lat, lon, *height in [*ring, *ring[:1]]] for ring in rings
    ]
    return {"type": "Polygon", "coordinates": coordinates}


def plan(
    *included: Corners, excluded: Sequence[Corners] = (), circles: Sequence[Any] = (), **more: Any
) -> str:
    """A plan with a fence."""
    polygons = [
        {"inclusion": is_inclusion, "polygon": [list(corner) for corner in ring], "version": 1}
        for rings, is_inclusion in ((included, True), (excluded, False))
        for ring in rings
    ]
    fence = {"circles": list(circles), "polygons": polygons, "version": 2}
    return json.dumps({"fileType": "Plan", "geoFence": fence, "version": 1, **more})


def circle(place: tuple[float, float], radius_m: float, *, inclusion: bool) -> dict[str, Any]:
    """A circle of a fence."""
    return {
        "circle": {"center": list(place), "radius": radius_m},
        "inclusion": inclusion,
        "version": 1,
    }
