"""The mission file: its schema and its loader."""

from dronemon.mission.load import MissionFile, find_mission, load_mission, shipped_missions
from dronemon.mission.schema import Mission

__all__ = ["Mission", "MissionFile", "find_mission", "load_mission", "shipped_missions"]
