"""What is heard of a rangefinder that looks down: MAVLink messages to ranges in vehicle time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CameraError

RANGE_MESSAGE = "DISTANCE_SENSOR"
_DOWN = mavlink.MAV_SENSOR_ROTATION_PITCH_270
_INVALID = 1
"""`signal_quality` of a reading that is none; 0 is one whose quality is not known."""
_KEPT = 128
GAP_S = 0.5
"""Vehicle time from one reading to the next by which what is between is not known."""


class _Reading(NamedTuple):
    """A range in m; NaN where there is nothing within the sensor's limits."""

    time_s: float
    range_m: float


class RangeTrack:
    """The last readings of one sensor. limits_m: least and greatest that it tells; None if unheard.

    Where several look down, the first heard is followed.
    """

    def __init__(self) -> None:
        self.limits_m: tuple[float, float] | None = None
        self._readings: deque[_Reading] = deque(maxlen=_KEPT)
        self._id: int | None = None

    def forget(self) -> None:
        """Begin anew, as with a vehicle's clock that does."""
        self.limits_m, self._id = None, None
        self._readings.clear()

    def take(self, fields: Mapping[str, Any], time_s: float) -> None:
        """Take one message, stamped so in vehicle time. Raises ValueError for what cannot be."""
        if fields["orientation"] != _DOWN or self._id not in (None, fields["id"]):
            return
        least, range_m, most = (
            float(fields[name]) / 100.0
            for name in ("min_distance", "current_distance", "max_distance")
        )
        if not 0.0 <= least < most < math.inf:  # NaN is never
            raise ValueError(f"tells {least} to {most} m")
        self._id, self.limits_m = fields["id"], (least, most)
        if time_s > self.newest_s:
            is_good = least <= range_m <= most and fields.get("signal_quality") != _INVALID
            self._readings.append(_Reading(time_s, range_m if is_good else math.nan))

    @property
    def newest_s(self) -> float:
        """Vehicle time of the newest reading."""
        return self._readings[-1].time_s if self._readings else -math.inf

    def at(self, time_s: float) -> float:
        """The range at an instant, between the readings about it. Raises CameraError."""
        after = next((r for r in self._readings if r.time_s >= time_s), None)
        before = next((r for r in reversed(self._readings) if r.time_s <= time_s), None)
        if before is None or after is None or after.time_s - before.time_s > GAP_S:
            raise CameraError(
                "the rangefinder's reading at the picture's instant was not heard, two within "
                f"{GAP_S:g} s are needed; does the vehicle still send {RANGE_MESSAGE} to this link?"
            )
        share = (time_s - before.time_s) / max(after.time_s - before.time_s, 1e-9)
        range_m = before.range_m + share * (after.range_m - before.range_m)
        if math.isnan(range_m):
            least_m, most_m = self.limits_m or (math.nan, math.nan)
            raise CameraError(
                f"the rangefinder finds no ground {least_m:g} to {most_m:g} m below the drone; is "
                "it too high, or over water?"
            )
        return range_m
