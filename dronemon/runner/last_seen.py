"""The last words on a drone that the program leaves with its motors running."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from dronemon.errors import VehicleError
from dronemon.frames import ned_to_geo
from dronemon.vehicle import Mode, VehicleLink

_WHAT_COMES = {
    Mode.RETURN: "it flies home and lands by itself",
    Mode.LAND: "it lands where it is",
    Mode.HOLD: "it stays there until its battery's failsafe acts",
    Mode.TAKEOFF: "it climbs and then stays there until its battery's failsafe acts",
    Mode.TERMINATION: "its autopilot has stopped the motors for good: it falls, or has fallen",
    Mode.OFFBOARD: "without setpoints its failsafe acts within seconds: by default it flies home",
}
FIRST_WORDS = "the motors may be running"
_FAILSAFE = (
    "its failsafe acts within seconds: by default it flies home, or comes down where it has no "
    "position"
)
_PILOTS = "whoever chose that mode flies it"


@dataclass(frozen=True, slots=True, kw_only=True)
class LastSeen:
    """Where and how a vehicle was heard last.

    heard_at: UTC, ISO 8601; place: None where no good position is known; down_m: of the local frame
    """

    heard_at: str
    mode: str
    is_armed: bool
    latitude_deg: float | None
    longitude_deg: float | None
    down_m: float | None
    what_comes: str

    @property
    def place(self) -> str:
        """Where, in words."""
        if self.latitude_deg is None:
            return "at an unknown place"
        return f"at {self.latitude_deg:.6f}, {self.longitude_deg:.6f}"

    @property
    def words(self) -> str:
        """All of it, and what a person should do."""
        armed = "armed" if self.is_armed else "disarmed, which may be wrong by now"
        return (
            f"{FIRST_WORDS}: heard last at {self.heard_at} {self.place}, {armed}, in mode "
            f"'{self.mode}'; {self.what_comes}; keep people away, take it over by remote control "
            "or a ground station, and see that it lands and disarms"
        )


def fallen(link: VehicleLink) -> str | None:
    """The last words on a drone whose motors stopped in the air, as by a kill switch."""
    if link.state.fell_from is None:
        return None
    return (
        "the motors stopped in the air, and it has fallen; heard last "
        f"{last_seen(link).place}; stay clear of its propellers, and take its battery out"
    )


def last_seen(link: VehicleLink) -> LastSeen:
    """What the newest telemetry says."""
    state = link.state
    latitude_deg = longitude_deg = down_m = None
    try:
        down_m = link.pose.position_ned_m[2]
        if state.origin is not None and state.is_position_good:
            place = ned_to_geo(np.array(link.pose.position_ned_m), state.origin)
            latitude_deg, longitude_deg = place.latitude_deg, place.longitude_deg
    except VehicleError:
        pass  # no pose was ever heard
    is_telling = state.mode in {Mode.RETURN, Mode.LAND, Mode.TERMINATION}
    heard_at = datetime.now(UTC) - timedelta(seconds=link.heartbeat_age_s)
    return LastSeen(
        heard_at=heard_at.isoformat(timespec="seconds"),
        mode=str(state.mode),
        is_armed=state.is_armed,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        down_m=down_m,
        what_comes=_FAILSAFE
        if state.is_failsafe and not is_telling
        else _WHAT_COMES.get(state.mode, _PILOTS),
    )
