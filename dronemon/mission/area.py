"""The area of a mission: a square, or a field of any shape with no-fly zones."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator

from dronemon.mission.section import Section
from dronemon.outline import check_heights, ring_in_degrees, ring_in_metres
from dronemon.problem import SENSOR_RADIUS_AU

_Metres = Annotated[float, Field(ge=-100_000.0, le=100_000.0)]
_LatLon = Annotated[tuple[float, float], Field(strict=False)]
_EastNorth = Annotated[tuple[_Metres, _Metres], Field(strict=False)]
PolygonDeg = Annotated[tuple[_LatLon, ...], Field(strict=False), AfterValidator(ring_in_degrees)]
PolygonM = Annotated[tuple[_EastNorth, ...], Field(strict=False), AfterValidator(ring_in_metres)]
_BORDERS = ("file", "polygon_deg", "polygon_m")


class NoFly(Section):
    """A zone of the area in which the drone may not be."""

    name: str = Field(min_length=1, max_length=80)
    """What it is called."""
    polygon_deg: PolygonDeg | None = None
    """Its corners in order, [latitude, longitude] each."""
    polygon_m: PolygonM | None = None
    """Its corners in order, metres [east, north] each of what the area's count from."""
    below_m: float | None = Field(None, gt=0.0, le=500.0)
    """How far up it reaches, from the take-off, or the ground with follow_terrain; if absent as far
    as height_m, else all the way."""
    height_m: float | None = Field(None, gt=0.0, le=500.0)
    """How far up from the ground something stands there, which hides what is behind it."""

    @model_validator(mode="after")
    def _fits_together(self) -> NoFly:
        if (self.polygon_deg is None) == (self.polygon_m is None):
            raise ValueError("give polygon_deg or polygon_m, one of them")
        check_heights(self.below_m, self.height_m)
        return self


def _side_m(given: dict[str, Any]) -> float:
    """Length of one au where the file does not say it."""
    radius_m: float | None = given.get("sensor_radius_m")
    return 200.0 if radius_m is None else radius_m / SENSOR_RADIUS_AU


class Area(Section):
    """The monitored area: a square around home, or around latitude and longitude; or any field."""

    sensor_radius_m: float | None = Field(None, ge=1.0, le=2000.0)
    """How far around itself the drone looks, 0.1 au; for a field that is no square."""
    side_m: float = Field(
        default_factory=_side_m,
        ge=10.0,
        le=20_000.0,
        description="Length of the square's side; one au. Ten times sensor_radius_m if absent, "
        "else 200.",
    )
    file: str | None = None
    """Outline of a field, .kml, .geojson or a QGroundControl .plan with a fence, from this file."""
    polygon_deg: PolygonDeg | None = None
    """Corners of a field in order, [latitude, longitude] each, instead of file."""
    polygon_m: PolygonM | None = None
    """The same in metres [east, north] of home, or of latitude_deg and longitude_deg."""
    no_fly: Annotated[tuple[NoFly, ...], Field(strict=False)] = Field((), max_length=100)
    """Zones where the drone may not be, beside the file's: a name, and polygon_deg or polygon_m."""
    heading_deg: float = Field(0.0, ge=-360.0, le=360.0)
    """Clockwise turn of the square's north side, and of what counts in au, from north."""
    latitude_deg: float | None = Field(None, ge=-90.0, le=90.0)
    """Latitude of the centre, from which metres count; home if absent."""
    longitude_deg: float | None = Field(None, ge=-180.0, le=180.0)
    """Longitude of the centre, from which metres count; home if absent."""
    terrain: str | None = None
    """Heights of the ground: a GeoTIFF, or an ESRI ASCII grid in degrees (.asc); flat if absent."""
    rangefinder: bool = False
    """Whether pictures are laid on level ground as far down as the drone's rangefinder tells."""

    @property
    def size(self) -> tuple[str, float]:
        """The key that says how large an au is, and its value."""
        if self.sensor_radius_m is not None:
            return "sensor_radius_m", self.sensor_radius_m
        return "side_m", self.side_m

    @property
    def border_key(self) -> str | None:
        """The key that says the field's border; None of a square."""
        return next((key for key in _BORDERS if getattr(self, key) is not None), None)

    @property
    def is_square(self) -> bool:
        """Whether it is a square in all of which the drone may be."""
        return self.border_key is None and not self.no_fly

    @model_validator(mode="after")
    def _fits_together(self) -> Area:
        if (self.latitude_deg is None) != (self.longitude_deg is None):
            raise ValueError(
                "give latitude_deg and longitude_deg together, or neither: "
                "the area is then centred on home"
            )
        given = [key for key in _BORDERS if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"give one of {' and '.join(given)}: each is a border of its own")
        radius_m = self.sensor_radius_m
        if given and radius_m is None:
            raise ValueError(
                f"{given[0]} needs sensor_radius_m, how far around itself the drone is to look; "
                "side_m is of a square alone"
            )
        if radius_m is not None and not math.isclose(
            self.side_m, _side_m({"sensor_radius_m": radius_m})
        ):
            raise ValueError(
                f"side_m {self.side_m:g} is not ten times sensor_radius_m, {radius_m:g}; leave one "
                "of them out"
            )
        return self
