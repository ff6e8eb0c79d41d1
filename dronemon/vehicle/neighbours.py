"""Who is heard on a link before anything is asked: which system is the vehicle to be flown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import WrongVehicle
from dronemon.vehicle.px4 import AUTOPILOT_COMPONENT, ROTORCRAFT

Heartbeats = Mapping[tuple[int, int], Mapping[str, Any]]
"""The fields of the newest heartbeat by system and component."""
_NAMES = {mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot", mavlink.MAV_AUTOPILOT_PX4: "PX4"}


def autopilots(heard: Heartbeats) -> dict[int, Mapping[str, Any]]:
    """Heartbeats of autopilots by system; cameras, gimbals, computers and people are none."""
    return {
        system: fields
        for (system, component), fields in heard.items()
        if component == AUTOPILOT_COMPONENT
        and fields.get("autopilot") != mavlink.MAV_AUTOPILOT_INVALID
    }


def choose(heard: Heartbeats, wanted: int | None, own: tuple[int, int], url: str) -> int:
    """The system to be flown; `wanted` where the mission names it.

    own: system and component that this program speaks as.

    Raises WrongVehicle.
    """
    if own in heard:
        raise WrongVehicle(
            f"another program speaks on {url} as system {own[0]}, component {own[1]}, as this one "
            "does: the vehicle cannot tell them apart; end one of them"
        )
    found = autopilots(heard)
    systems = ", ".join(map(str, sorted(found)))
    if wanted is not None and wanted not in found:
        raise WrongVehicle(
            f"no autopilot of system {wanted} is heard on {url}, only of {systems}; "
            "is vehicle.system_id right?"
        )
    if wanted is None and len(found) > 1:
        raise WrongVehicle(
            f"several vehicles are heard on {url}, systems {systems}; choose one by "
            "vehicle.system_id, or give each a port of its own"
        )
    system = wanted if wanted is not None else next(iter(found))
    _check(found[system], system, url)
    return system


def _check(fields: Mapping[str, Any], system: int, url: str) -> None:
    """Refuse what is no PX4 rotorcraft."""
    autopilot, kind = fields.get("autopilot"), fields.get("type")
    if autopilot != mavlink.MAV_AUTOPILOT_PX4:
        name = _NAMES.get(autopilot, "another autopilot")
        raise WrongVehicle(
            f"system {system} on {url} is {name} (autopilot {autopilot}), not PX4 (12), "
            "whose modes and failsafes a mission counts on; it is not flown"
        )
    if kind not in ROTORCRAFT:
        raise WrongVehicle(
            f"system {system} on {url} is no rotorcraft (type {kind}): it cannot hover; "
            "it is not flown"
        )
