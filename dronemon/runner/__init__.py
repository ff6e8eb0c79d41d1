"""Flies a mission: links, patrol, the way home. It reads as the mission's story."""

from dronemon.runner.flight import FlightResult, fly_mission
from dronemon.runner.inspection import inspect_vehicle, refusal
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.preparation import FlightSetup, mission_kernel, rehearse

__all__ = [
    "FlightResult",
    "FlightSetup",
    "Interrupts",
    "fly_mission",
    "inspect_vehicle",
    "mission_kernel",
    "refusal",
    "rehearse",
]
