"""Planners: they take a snapshot of the mission and return the next waypoint."""

from dronemon.planner.planner import Briefing, Clairvoyant, Planner, Snapshot, TargetsAt, Waypoint

__all__ = ["Briefing", "Clairvoyant", "Planner", "Snapshot", "TargetsAt", "Waypoint"]
