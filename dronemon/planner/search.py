"""Search in the space of beliefs: fly the path that should leave the targets least uncertain.

At every waypoint the particles are walked on over the horizon; many paths are drawn and refined
against them, the last best one among them; one step of the best is flown. Nothing is trained, and
one setting serves any number and speed of targets.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dronemon.belief import Belief
from dronemon.errors import PlannerError
from dronemon.planner import moving, paths, scoring
from dronemon.planner.motion import ARRIVED_AU, step_towards, until_measurement_au
from dronemon.planner.particles import ParticleBelief
from dronemon.planner.planner import Briefing, Snapshot, TargetsAt, Waypoint
from dronemon.planner.settings import SearchSettings
from dronemon.problem import MEASUREMENT_INTERVAL_AU, SENSOR_RADIUS_AU, WINDOW_AU
from dronemon.roadmap import Roadmap
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, IntArray
from dronemon.world import measure

_SOON_AU = 1e-3
"""Time in which a heading is told."""


class SearchPlanner:
    """Flies freely, a measurement's interval at a time."""

    name = "search"

    def __init__(self, settings: SearchSettings | None = None) -> None:
        self.settings = settings if settings is not None else SearchSettings()

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        """Begin a mission: particles at the priors, and all code compiled before take-off."""
        _compile()
        self._begin(briefing, roadmap)

    def _begin(self, briefing: Briefing, roadmap: Roadmap) -> None:
        self._rng = briefing.rng
        self._particles = ParticleBelief(
            briefing.priors_au.reshape(-1, 2),
            self.settings.motion,
            self._rng,
            num_imagined=briefing.num_imagined,
            arena=briefing.arena,
            sensor=briefing.sensor,
        )
        if briefing.sightings is not None:
            self._particles.learn(briefing.sightings)
        self._arena = briefing.arena
        self._ground = self._make_ground(roadmap)
        self._goals = np.zeros((paths.MAX_GOALS, 2))
        self._num_goals = 0

    def _make_ground(self, roadmap: Roadmap) -> moving.Ground:
        return moving.Ground.of(self._arena)

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """One step along the best path found."""
        num_taken = math.floor(snapshot.flown_au / MEASUREMENT_INTERVAL_AU + 1e-9)
        due_au = until_measurement_au(snapshot.flown_au - num_taken * MEASUREMENT_INTERVAL_AU)
        x_au, y_au = snapshot.position_au.tolist()
        start = paths.Start(x_au, y_au, -1, due_au)
        found = self._search(snapshot, start, np.empty(0, dtype=np.int64))
        first_au = self._first(snapshot.position_au, due_au, found)
        if not _is_found(found.gain) or math.dist(first_au, snapshot.position_au) <= ARRIVED_AU:
            raise PlannerError(f"search found no path from {snapshot.position_au}; report this")
        self._keep(found, first_au)
        return Waypoint(
            position_au=first_au,
            details={
                "gain": found.gain,
                "speed": self._particles.speed.mean,
                "path": found.path_au.tolist(),
            },
        )

    def _first(self, here_au: FloatArray, due_au: float, found: paths.Found) -> FloatArray:
        """Where the path first measures or turns; here if it leads nowhere."""
        if self._arena.is_rectangle:  # there it turns only where it measures
            measured_au: FloatArray = found.path_au[0]
            return measured_au
        for goal_au in found.goals_au[: found.num_goals]:
            turn_au = self._arena.way(here_au, goal_au)[0]
            if math.dist(turn_au, here_au) > ARRIVED_AU:
                return step_towards(here_au, turn_au, due_au)
        return here_au

    def _keep(self, found: paths.Found, reached_au: FloatArray) -> None:
        """Remember the best path's goals, less those that the next waypoint reaches."""
        done, count = 0, found.num_goals
        while done < count and math.dist(found.goals_au[done], reached_au) < 0.05:
            done += 1
        self._num_goals = count - done
        self._goals[: self._num_goals] = found.goals_au[done:count]

    def _foreseen(self, time_au: float) -> tuple[FloatArray, FloatArray, float]:
        """Give the particles now and at the next measurements, and their speed.

        -> (N, m, 2), (H, N, m, 2), ratio to the agent's
        """
        speed = self._particles.speed.mean
        num_steps = self.settings.horizon(speed)
        count = max(1, self.settings.num_places // (num_steps * len(self._particles.targets)))
        now, later = self._particles.futures(
            min(self.settings.num_planned, count), num_steps, MEASUREMENT_INTERVAL_AU
        )
        return now, later, speed

    def _search(self, snapshot: Snapshot, start: paths.Start, options: IntArray) -> paths.Found:
        """Learn what the log holds, look ahead, and find the best path from here."""
        self._particles.learn(snapshot.sightings)
        self._particles.advance(snapshot.time_au)
        now_au, later_au, speed = self._foreseen(snapshot.time_au)
        tables = scoring.make_tables(self.settings, speed)
        found: paths.Found = paths.search(
            start,
            self._ground,
            options,
            self._forecast(snapshot, now_au, later_au, tables),
            tables,
            paths.Effort.of(self.settings),
            self._goals,
            self._num_goals,
            self._rng,
        )
        return found

    def _forecast(
        self, snapshot: Snapshot, now_au: FloatArray, later_au: FloatArray, tables: scoring.Tables
    ) -> scoring.Forecast:
        """What paths are scored in.

        now_au:   (N, m, 2)    au particles of each target
        later_au: (H, N, m, 2) au the same at the next measurements
        """
        num_targets, num_each = now_au.shape[:2]
        first = np.arange(num_targets + 1) * num_each
        # A guess where a missed target was is not a look at it: who plans by it loses it.
        window = snapshot.sightings.window(WINDOW_AU, num_targets, in_hindsight=False)
        probe_age = np.empty((num_targets * num_each, 4), dtype=np.int32)
        scoring.probe_ages(
            np.ascontiguousarray(now_au.reshape(-1, 2)),
            first,
            window.points,
            window.mask,
            snapshot.time_au,
            tables,
            probe_age,
        )
        since = (snapshot.time_au - self._particles.last_seen_au) / MEASUREMENT_INTERVAL_AU
        weight = np.full(num_targets, 1.0 / num_each)
        weight[np.isinf(since)] *= self.settings.unfound_weight
        num_unknown = self.settings.num_unknown * self._particles.undetected
        weight[snapshot.sightings.num_targets :] *= num_unknown
        flat = later_au.astype(np.float32).reshape(len(later_au), -1, 2)
        return scoring.Forecast(
            x=np.ascontiguousarray(flat[..., 0]),
            y=np.ascontiguousarray(flat[..., 1]),
            weight=np.repeat(weight, num_each).astype(np.float32),
            probe_age=probe_age,
            sight_age=np.repeat(np.rint(since.clip(0, scoring.OLDEST)), num_each).astype(np.int32),
            first=first,
            mean=self._means(snapshot, num_targets),
            bounds=self._arena.bounds,
            together=self._together(later_au[-1]),
        )

    def _together(self, places_au: FloatArray) -> NDArray[np.float32]:
        """How much of each target is in view at once, as `Forecast.together` has it.

        places_au: (N, m, 2) au particles
        """
        if math.hypot(*self._arena.extent_au) <= self.settings.num_steps * MEASUREMENT_INTERVAL_AU:
            return np.empty(0, dtype=np.float32)
        apart_au = np.linalg.norm(places_au[:, :, None] - places_au[:, None], axis=-1)
        shares: NDArray[np.float32] = (apart_au < SENSOR_RADIUS_AU).mean(
            axis=(1, 2), dtype=np.float32
        )
        return self.settings.beyond_worth * shares

    def _means(self, snapshot: Snapshot, num_targets: int) -> NDArray[np.float32]:
        """The belief's means now, as `Forecast.mean` has it; 0 for an imagined target."""
        columns, rows = scoring.mean_cells(self._arena)
        cells_au = self._arena.cells(columns, rows)
        query_au = np.column_stack([cells_au, np.full(len(cells_au), snapshot.time_au)])
        mean = np.zeros((num_targets, columns, rows), dtype=np.float32)
        known = snapshot.belief.num_targets
        mean[:known] = snapshot.belief.mean(query_au).reshape(known, *mean.shape[1:])
        return mean


class RoadmapSearchPlanner(SearchPlanner):
    """Decides at roadmap nodes, as the learned policy does; its teacher."""

    name = "search-roadmap"

    def _make_ground(self, roadmap: Roadmap) -> moving.Ground:
        return moving.Ground.of(self._arena, roadmap)

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """The neighbour by way of which the best path goes; details hold every neighbour's gain."""
        nodes_au = snapshot.roadmap.nodes_au
        node = snapshot.node
        if node is None:
            node = int(np.linalg.norm(nodes_au - snapshot.position_au, axis=-1).argmin())
        neighbours = snapshot.roadmap.neighbours[node]
        neighbours = neighbours[neighbours != node]
        x_au, y_au = snapshot.position_au.tolist()
        start = paths.Start(x_au, y_au, node, until_measurement_au(snapshot.flown_au))
        found = self._search(snapshot, start, neighbours)
        if not _is_found(found.gain):
            raise PlannerError(f"search found no way from node {node}; report this")
        hop_au = nodes_au[found.hop]
        self._keep(found, hop_au)
        return Waypoint(
            position_au=hop_au,
            node=found.hop,
            details={
                "gain": found.gain,
                "neighbours": neighbours.tolist(),
                "neighbour_gains": found.option_gains.tolist(),
            },
        )


class ClairvoyantSearchPlanner(SearchPlanner):
    """The same search, told where the targets are and will be: what ours is measured against."""

    name = "clairvoyant-search"

    def foresee(self, targets_at: TargetsAt) -> None:
        """Take the truth of the next mission."""
        self._targets_at = targets_at

    def _foreseen(self, time_au: float) -> tuple[FloatArray, FloatArray, float]:
        """The true places, and the mean speed now."""
        nearby = self._targets_at(time_au + np.array([0.0, MEASUREMENT_INTERVAL_AU]))
        walked = np.linalg.norm(nearby[1] - nearby[0], axis=-1)
        speed = max(float(np.mean(walked)) / MEASUREMENT_INTERVAL_AU, 1e-3)
        steps = np.arange(self.settings.horizon(speed) + 1, dtype=np.float64)
        times_au: FloatArray = time_au + MEASUREMENT_INTERVAL_AU * steps
        places: FloatArray = self._targets_at(times_au)[:, :, None]
        return places[0], places[1:], speed


class PresentSearchPlanner(ClairvoyantSearchPlanner):
    """The same search, told where the targets are now and whither they go, but not what follows.

    Between it and ours lies what better beliefs could bring, between it and the clairvoyant what
    knowing the future could.
    """

    name = "present-search"

    def _foreseen(self, time_au: float) -> tuple[FloatArray, FloatArray, float]:
        """The true places now, walked on as the particles are."""
        places_au, soon_au = self._targets_at(time_au + np.array([0.0, _SOON_AU]))
        self._particles.place(places_au, (soon_au - places_au) / _SOON_AU)
        return SearchPlanner._foreseen(self, time_au)


def _is_found(gain: float) -> bool:
    return math.isfinite(gain) and gain > paths.NOTHING


@cache
def _compile() -> None:
    """Have all compiled code ready, by a decision that is thrown away."""
    planner = SearchPlanner()
    here_au = np.array([0.5, 0.5])
    roadmap = Roadmap(nodes_au=here_au[None], neighbours=np.zeros((1, 1), dtype=np.int64))
    sightings = Sightings(here_au[None])
    planner._begin(
        Briefing(
            num_targets=1,
            priors_au=sightings.priors_au,
            start_au=here_au,
            horizon_au=1.0,
            rng=np.random.default_rng(0),
        ),
        roadmap,
    )
    # Misses where the target must be, so that all particles are replaced, and a sight.
    for time_au, target_au in ((0.1, here_au + 1.0), (0.2, here_au + 1.0), (0.3, here_au)):
        sightings.add(measure(time_au, here_au, target_au[None]))
    planner.next_waypoint(
        Snapshot(
            time_au=0.3,
            flown_au=0.3,
            position_au=here_au,
            node=None,
            sightings=sightings,
            belief=Belief(sightings),
            roadmap=roadmap,
            remaining_au=0.7,
        )
    )
