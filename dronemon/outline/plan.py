"""The geofence of a QGroundControl plan: polygons and circles, latitude before longitude.

Source: QGroundControl, "Plan File Format".
"""

from __future__ import annotations

import math
from typing import Any

from dronemon.frames import GeoPoint, ned_to_degrees
from dronemon.outline.feature import Feature, Flaw, Ring, blamed_on
from dronemon.outline.json_file import listed, mapped, numbers, parse_json
from dronemon.outline.rings import FARTHEST_M, circle_in_metres, ring_in_degrees

_VERSION = 2


def plan_features(text: str) -> list[Feature]:
    """Every fence of a plan; those of exclusion are no-fly. Raises Flaw."""
    root = parse_json(text)
    if root.get("fileType") != "Plan":
        raise Flaw(
            f"fileType is {root.get('fileType')!r:.60}, not 'Plan'; save it by QGroundControl"
        )
    fence = mapped(root.get("geoFence") or {}, "geoFence")
    if fence and fence.get("version") != _VERSION:
        raise Flaw(
            f"geoFence is of version {fence.get('version')!r:.20}, not {_VERSION}; open it with a "
            "newer QGroundControl, and save it"
        )
    polygons = listed(fence.get("polygons", []), "geoFence.polygons")
    circles = listed(fence.get("circles", []), "geoFence.circles")
    if not polygons and not circles:
        raise Flaw("has no fence; draw one on QGroundControl's page Fence, and save the plan")
    return [
        *(_feature(f"fence polygon {n}", one) for n, one in enumerate(polygons, start=1)),
        *(_feature(f"fence circle {n}", one) for n, one in enumerate(circles, start=1)),
    ]


def _feature(label: str, entry: object) -> Feature:
    with blamed_on(label):
        given = mapped(entry, "it")
        is_inclusion = given.get("inclusion")
        if not isinstance(is_inclusion, bool):
            raise Flaw("inclusion is neither true nor false")
        if "circle" in given:
            ring = _around(mapped(given["circle"], "circle"), is_inclusion)
        else:
            corners = listed(given.get("polygon"), "polygon")
            ring = ring_in_degrees(numbers(corner, "a corner", (2, 3)) for corner in corners)
    return Feature(label=label, name="", is_no_fly=not is_inclusion, polygons=((ring,),))


def _around(circle: dict[str, Any], is_inclusion: bool) -> Ring:
    """A polygon within a circle that is included, around one that is excluded."""
    centre = numbers(circle.get("center"), "center", (2,))
    radius_m = circle.get("radius")
    if not (isinstance(radius_m, float) and 0.0 < radius_m <= FARTHEST_M):
        raise Flaw(f"radius {radius_m!r:.20} is not from 0 to {FARTHEST_M:g} m")
    if not all(map(math.isfinite, centre)) or abs(centre[0]) > 90.0:
        raise Flaw("its center is no latitude and longitude")
    rim_m = circle_in_metres(radius_m, is_inside=is_inclusion)
    return ring_in_degrees(ned_to_degrees(rim_m, GeoPoint.at(centre)).tolist())
