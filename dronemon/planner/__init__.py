"""Planners: they take a snapshot of the mission and return the next waypoint."""

from dronemon.planner.planner import (
    Briefing,
    Clairvoyant,
    Explaining,
    Planner,
    Snapshot,
    TargetsAt,
    Waypoint,
)
from dronemon.planner.registry import create_planner, files_outside, has_weights, planner_names

__all__ = [
    "Briefing",
    "Clairvoyant",
    "Explaining",
    "Planner",
    "Snapshot",
    "TargetsAt",
    "Waypoint",
    "create_planner",
    "files_outside",
    "has_weights",
    "planner_names",
]
