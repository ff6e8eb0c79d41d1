"""A field's outline from users' files: KML, GeoJSON, QGroundControl's fence."""

from dronemon.outline.feature import Ring, check_heights
from dronemon.outline.field import Field, LaidZone
from dronemon.outline.outline import Outline, Zone
from dronemon.outline.reading import read_outline
from dronemon.outline.rings import (
    away_m,
    circle_in_metres,
    ring_in_degrees,
    ring_in_metres,
    unwound,
)

__all__ = [
    "Field",
    "LaidZone",
    "Outline",
    "Ring",
    "Zone",
    "away_m",
    "check_heights",
    "circle_in_metres",
    "read_outline",
    "ring_in_degrees",
    "ring_in_metres",
    "unwound",
]
