"""Flies a mission: links, patrol, the way home. It reads as the mission's story."""

from dronemon.runner.flight import FlightResult, fly
from dronemon.runner.preparation import mission_kernel, rehearse
from dronemon.runner.status import Audience, FlightStatus, Interrupts

__all__ = [
    "Audience",
    "FlightResult",
    "FlightStatus",
    "Interrupts",
    "fly",
    "mission_kernel",
    "rehearse",
]
