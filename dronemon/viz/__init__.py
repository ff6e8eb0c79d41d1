"""What a flight shows: a Rerun recording, and a live view of it."""

from dronemon.viz.entities import belief_grid_au
from dronemon.viz.stream import FlightView

__all__ = ["FlightView", "belief_grid_au"]
