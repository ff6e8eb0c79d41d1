"""What a flight shows: a Rerun recording, and a live view of it."""

from dronemon.viz.stream import FlightView

__all__ = ["FlightView"]
