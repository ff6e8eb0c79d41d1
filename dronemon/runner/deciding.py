"""A planner's choice in flight: judged before it is flown to, and made ready for the record."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

from dronemon.arena import Arena
from dronemon.errors import PlannerError
from dronemon.json_values import json_value
from dronemon.planner import Explaining, Planner, Snapshot, Waypoint
from dronemon.planner.motion import waypoint_flaw
from dronemon.types import FloatArray, IntArray


def decide(
    planner: Planner, snapshot: Snapshot, here_au: FloatArray, arena: Arena
) -> tuple[Waypoint, Mapping[str, FloatArray | IntArray]]:
    """Where it flies next from a place (2,) au, and what it looked at. Raises PlannerError.

    The waypoint's details are as they can be recorded.
    """
    waypoint = planner.next_waypoint(snapshot)
    if flaw := waypoint_flaw(waypoint, here_au, arena):
        raise PlannerError(f"planner '{planner.name}' gave {flaw}")
    details = {str(name): json_value(value) for name, value in waypoint.details.items()}
    position_au = arena.clip_free(waypoint.position_au)
    waypoint = Waypoint(position_au=position_au, node=waypoint.node, details=details)
    return waypoint, _weights(planner)


def _weights(planner: Planner) -> Mapping[str, FloatArray | IntArray]:
    """What it looked at, if it says so: a failure costs those who watch, and not the flight."""
    if isinstance(planner, Explaining):
        with contextlib.suppress(Exception):
            return planner.explanation().arrays()
    return {}
