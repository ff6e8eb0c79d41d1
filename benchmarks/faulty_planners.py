"""Planners that fail, for `benchmarks/faults.py`: each flies to and fro until its fault is due."""

from __future__ import annotations

import time

import numpy as np

from dronemon.planner import Briefing, Snapshot, Waypoint
from dronemon.roadmap import Roadmap

_FAULT_AT_AU = 0.2


class Shuttle:
    """Flies to and fro."""

    name = "shuttle"

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        """Begin a mission."""
        self._start_au = briefing.start_au
        self._is_out = False

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """The other end."""
        if snapshot.flown_au >= _FAULT_AT_AU:
            self.fail()
        self._is_out = not self._is_out
        way_au = np.where(self._start_au < 0.5, 0.25, -0.25)
        return Waypoint(position_au=self._start_au + self._is_out * way_au)

    def fail(self) -> None:
        """Do what is wrong with this one."""


class Raising(Shuttle):
    """Raises an error."""

    name = "raising"

    def fail(self) -> None:
        """An error."""
        raise IndexError("no node there")


class Slow(Shuttle):
    """Takes half a second for each waypoint."""

    name = "slow"

    def fail(self) -> None:
        """A pause."""
        time.sleep(0.5)


class Hanging(Shuttle):
    """Never answers."""

    name = "hanging"

    def fail(self) -> None:
        """For ever."""
        time.sleep(1e6)
