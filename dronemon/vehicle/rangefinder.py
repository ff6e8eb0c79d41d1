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
RANGE_GAP_S = 0.5
"""Vehicle time from one reading to the next by which what is between is not known."""
_SILENT_S, _FUTURE_S = 1.0, 1.0
"""Time after which a sensor is not heard any more, and by which a stamp cannot be ahead."""


class _Reading(NamedTuple):
    """A range in m; NaN where there is nothing within the sensor's limits."""

    time_s: float
    range_m: float


class RangeTrack:
    """The last readings of one sensor; of several that look down, the first that is heard."""

    def __init__(self) -> None:
        self._limits_m = (math.nan, math.nan)
        self._readings: deque[_Reading] = deque(maxlen=_KEPT)
        self._id: int | None = None

    def forget(self) -> None:
        """Begin anew, as with a vehicle's clock that does."""
        self._readings.clear()

    def take(self, fields: Mapping[str, Any], time_s: float, now_s: float) -> None:
        """Take one message, stamped so in vehicle time. Raises ValueError for what cannot be."""
        is_other = fields["id"] != self._id and now_s - self.newest_s <= _SILENT_S
        if fields["orientation"] != _DOWN or is_other or time_s <= self.newest_s:
            return
        least, range_m, most = (
            float(fields[name]) / 100.0
            for name in ("min_distance", "current_distance", "max_distance")
        )
        if not 0.0 <= least < most < math.inf:  # NaN is never
            raise ValueError(f"tells {least} to {most} m")
        if time_s > now_s + _FUTURE_S:
            raise ValueError(f"is stamped {time_s - now_s:.1f} s ahead")
        if fields["id"] != self._id:
            self._readings.clear()
        self._id, self._limits_m = fields["id"], (least, most)
        is_good = range_m > 0.0 and least <= range_m <= most
        is_good = is_good and fields.get("signal_quality") != _INVALID
        self._readings.append(_Reading(time_s, range_m if is_good else math.nan))

    def limits_m(self, now_s: float) -> tuple[float, float] | None:
        """Least and greatest range that it tells; None if it is not heard, or not often enough."""
        if len(self._readings) < 2 or now_s - self.newest_s > _SILENT_S:
            return None
        interval_s = self.newest_s - self._readings[-2].time_s
        return self._limits_m if interval_s <= RANGE_GAP_S else None

    @property
    def newest_s(self) -> float:
        """Vehicle time of the newest reading."""
        return self._readings[-1].time_s if self._readings else -math.inf

    def at(self, time_s: float) -> float:
        """The range at an instant, between the readings about it. Raises CameraError."""
        after = next((r for r in self._readings if r.time_s >= time_s), None)
        before = next((r for r in reversed(self._readings) if r.time_s <= time_s), None)
        if before is None or after is None or after.time_s - before.time_s > RANGE_GAP_S:
            raise CameraError(
                "the rangefinder's reading at the picture's instant was not heard, two within "
                f"{RANGE_GAP_S:g} s are needed; does the vehicle still send {RANGE_MESSAGE} to "
                "this link?"
            )
        range_m = before.range_m
        if after.time_s > before.time_s:
            share = (time_s - before.time_s) / (after.time_s - before.time_s)
            range_m += share * (after.range_m - before.range_m)
        if math.isnan(range_m):
            least_m, most_m = self._limits_m
            raise CameraError(
                f"the rangefinder finds no ground {least_m:g} to {most_m:g} m below the drone; is "
                "it too high, or over water?"
            )
        return range_m
