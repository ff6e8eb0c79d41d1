"""The TSP loop: a shortest closed tour of where the targets are thought to be, again and again.

A target that is not found where it was thought to be is skipped until its turn comes again. Four
planners differ only in where they think a target is: where it was last seen, where it would be had
it kept on, where the belief of it peaks, or where it truly is, as a bound on the others.

Source: paper, section V-A, after Yu et al. (2017). The paper leaves open what sight of a target
does to the leg that leads to it. Here the leg is bent to where the target is; ending it at first
sight, or flying it to its old end, moves Unc by about 0.01, up or down.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from dronemon.arena import Arena
from dronemon.planner.lawnmower import Sweep, sweep_length_au
from dronemon.planner.motion import orbit, step_towards, until_measurement_au, way_length_au
from dronemon.planner.planner import Briefing, Snapshot, TargetsAt, Waypoint
from dronemon.planner.tours import shortest_loop
from dronemon.types import FloatArray, IntArray

if TYPE_CHECKING:
    from dronemon.roadmap import Roadmap

REACHED_AU = 1e-3
"""Distance at which a target's place counts as visited."""
INTERCEPT_ROUNDS = 4
"""Fixed-point rounds of meeting a moving target; each divides the miss by the speed ratio."""
SHORTEST_AU = 0.01
"""Sights nearer in time than this are taken to lie this far apart, to bound the speed read off."""
PREDICTION_AU = 1.0
"""How much later a belief's peak is sought."""
PEAK_GRID = 21
"""Points per axis among which a belief's peak is sought: 0.05 au apart, half a length scale."""


PlacesAt = Callable[[float], FloatArray]
"""Where targets are thought to be at a time not before now. -> (N, 2) au, NaN where unknown."""
Whereabouts = Callable[[Snapshot, Arena], PlacesAt]
"""What is thought of the known targets' places."""


class TspLoop:
    """Visits each target's supposed place in the order of a shortest loop, round and round.

    The loop is planned anew whenever a target was seen or visited, and flown on in the same sense.
    While some target's place is unknown, or before the first sweep of a mission that does not know
    how many targets there are, the lawnmower's lanes are flown instead.
    """

    def __init__(self, name: str, whereabouts: Whereabouts) -> None:
        self.name = name
        self._whereabouts = whereabouts

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        """Forget the loop."""
        self._arena = briefing.arena
        self._sweep = Sweep(briefing.arena)
        self._sweep_until_au = (
            0.0 if briefing.num_targets else sweep_length_au(self._sweep.track_au)
        )
        self._loop = np.empty(0, dtype=np.int64)
        self._goal = 0
        self._num_read = 0

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """Step towards the goal, as far as the next measurement, which may move it."""
        self._places_at = self._whereabouts(snapshot, self._arena)
        places_au = self._places(snapshot.time_au)
        here_au, step_au = snapshot.position_au, until_measurement_au(snapshot.flown_au)
        if (
            not len(places_au)
            or np.isnan(places_au).any()
            or snapshot.flown_au < self._sweep_until_au
        ):
            place_au = self._sweep.next_place(here_au)
            return Waypoint(position_au=step_towards(here_au, place_au, step_au))
        was_seen = any(m.seen.any() for m in snapshot.sightings.since(self._num_read))
        self._num_read = len(snapshot.sightings)
        if was_seen or len(self._loop) != len(places_au):
            self._plan(places_au, here_au)
        for _ in places_au:
            meeting_au = self._meeting_point(snapshot)
            if np.linalg.norm(meeting_au - here_au) > REACHED_AU:
                break
            self._plan(places_au, here_au)
            self._goal = _successor(self._loop, self._goal)
        else:  # all of them are here
            meeting_au = orbit(here_au, meeting_au, self._arena)
        way_au = self._arena.way(here_au, meeting_au)
        return Waypoint(
            position_au=step_towards(here_au, way_au[0], step_au),
            details={"goal": self._goal, "loop": self._loop.tolist()},
        )

    def _places(self, time_au: float) -> FloatArray:
        """Where targets are met: one seen beyond the border, at it. -> (N, 2) au."""
        return self._arena.clip_free(self._places_at(time_au))

    def _plan(self, places_au: FloatArray, here_au: FloatArray) -> None:
        """Find the shortest loop; a first one begins with the nearest target."""
        loop = shortest_loop(self._arena.distances(places_au, places_au))
        if len(self._loop) == len(loop):
            backwards = loop[::-1]
            if _shared_steps(self._loop, backwards) > _shared_steps(self._loop, loop):
                loop = backwards
        else:
            self._goal = int(self._arena.distances(here_au[None], places_au)[0].argmin())
        self._loop = loop

    def _meeting_point(self, snapshot: Snapshot) -> FloatArray:
        """Where the goal is met if we fly there by the shortest way. -> (2,)."""
        here_au, arrival_au = snapshot.position_au, snapshot.time_au
        for _ in range(INTERCEPT_ROUNDS):
            meeting_au: FloatArray = self._places(arrival_au)[self._goal]
            distance_au = way_length_au(here_au, self._arena.way(here_au, meeting_au))
            arrival_au = snapshot.time_au + distance_au
        return meeting_au


def _successor(loop: IntArray, target: int) -> int:
    """Target that follows another in a loop."""
    place = int(np.flatnonzero(loop == target)[0])
    return int(loop[(place + 1) % len(loop)])


def _shared_steps(a: IntArray, b: IntArray) -> int:
    """How many targets are followed by the same one in two loops."""
    return sum(_successor(a, target) == _successor(b, target) for target in a.tolist())


def last_seen(snapshot: Snapshot, arena: Arena) -> PlacesAt:
    """Where each target was last seen; the places known before the mission count as sights."""
    places_au = snapshot.sightings.last_places_au
    return lambda time_au: places_au


def carried_on(snapshot: Snapshot, arena: Arena) -> PlacesAt:
    """Where each target would be had it kept on as it moved between its last two sights."""
    sightings = snapshot.sightings
    places_au, times_au = sightings.last_places_au, sightings.last_seen_au
    velocities = np.zeros_like(places_au)
    for target in range(sightings.num_targets):
        sights = sightings.sights(target, before_au=math.inf, most=2)
        if len(sights) == 2:
            then, now = np.array(sights)
            velocities[target] = (now[1:] - then[1:]) / max(now[0] - then[0], SHORTEST_AU)
    times_au = np.where(np.isfinite(times_au), times_au, 0.0)  # of those whose place is unknown
    return lambda time_au: places_au + velocities * (time_au - times_au)[:, None]


def predicted(snapshot: Snapshot, arena: Arena) -> PlacesAt:
    """Where the belief's mean will peak a little later; the last-seen place where it has none."""
    last_seen_au, grid_au = snapshot.sightings.last_places_au, arena.grid(PEAK_GRID)
    times_au = np.full(len(grid_au), snapshot.time_au + PREDICTION_AU)
    mean = snapshot.belief.mean(np.column_stack([grid_au, times_au]))
    is_found = (mean.max(axis=1) > 0.0) & np.isfinite(last_seen_au).all(axis=1)
    places_au = np.where(is_found[:, None], grid_au[mean.argmax(axis=1)], last_seen_au)
    return lambda time_au: places_au


class ClairvoyantTspLoop(TspLoop):
    """The TSP loop of one who knows where every target is and will be."""

    def __init__(self) -> None:
        super().__init__("clairvoyant", self._true_places)

    def foresee(self, targets_at: TargetsAt) -> None:
        """Take the truth of the next mission."""
        self._targets_at = targets_at

    def _true_places(self, snapshot: Snapshot, arena: Arena) -> PlacesAt:
        return lambda time_au: self._targets_at(np.array([time_au]))[0]
