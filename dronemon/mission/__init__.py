"""The mission file: its schema and its loader."""

from dronemon.mission.schema import Mission

__all__ = ["Mission"]
