"""The mission file: its schema and its loader."""

from dronemon.mission.field import (
    check_near,
    field_centre,
    lay_frame,
    mission_arena,
    mission_obstacles,
    reach_m,
)
from dronemon.mission.load import MissionFile, find_mission, load_mission, shipped_missions
from dronemon.mission.schema import Mission

__all__ = [
    "Mission",
    "MissionFile",
    "check_near",
    "field_centre",
    "find_mission",
    "lay_frame",
    "load_mission",
    "mission_arena",
    "mission_obstacles",
    "reach_m",
    "shipped_missions",
]
