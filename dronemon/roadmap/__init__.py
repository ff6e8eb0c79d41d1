"""Where the agent may go next: a random roadmap over the unit square."""

from dronemon.roadmap.graph import Roadmap

__all__ = ["Roadmap"]
