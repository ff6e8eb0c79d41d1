"""Search in the space of beliefs: fly the path that should leave the targets least uncertain.

At every waypoint the particles are walked on over the horizon; many paths are drawn and refined
against them, the last best one among them; one step of the best is flown. Nothing is trained, and
one setting serves any number and speed of targets.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from dronemon.errors import PlannerError
from dronemon.planner import moving, paths, scoring
from dronemon.planner.motion import ARRIVED_AU, until_measurement_au
from dronemon.planner.particles import MotionSettings, ParticleBelief
from dronemon.planner.planner import Briefing, Snapshot, TargetsAt, Waypoint
from dronemon.problem import MEASUREMENT_INTERVAL_AU, WINDOW_AU
from dronemon.roadmap import Roadmap
from dronemon.types import FloatArray, IntArray, Measurement

_NEXT_AU = 0.03
"""A measurement nearer than this is left to come as it may: no waypoint is as near as that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchSettings:
    """How the search looks ahead and what it values.

    Compared by `benchmarks/tune_search.py` on development seeds; ablations are in DESIGN.md.
    """

    num_steps: int = 26
    """Longest horizon, in measurements."""
    walk_au: float = 0.18
    """Walk of a target after which its place is a guess; the horizon ends there at the latest."""
    num_drawn: int = 200
    """Paths drawn at every decision."""
    num_refined: int = 150
    """Small changes of the best path tried after that."""
    num_planned: int = 40
    """Most particles of each target that paths are scored against."""
    num_planned_in_all: int = 240
    """Most particles of all targets; bounds the time of a decision."""
    discount: float = 0.985
    """Worth of a gain one measurement later."""
    fading: float = 0.985
    """Worth of certainty that lasts one measurement longer."""
    drift: float = 0.7
    """Share of a target's speed at which it leaves the place of a measurement behind."""
    probe_au: float = 0.065
    """Distance of the four probes around a target; the mean over its area is about that at it."""
    sight_gain: float = 2.0
    """Worth of having seen a target, for each measurement that the knowledge lasts."""
    forget_steps: float = 25.0
    """Measurements in which that knowledge fades to 1/e."""
    shape_worth: float = 1.0
    """Worth of a belief's mean nearer to its target's presence, per squared error at r_v = 1/30."""
    guided_share: float = 0.7
    """Paths whose goals are drawn by urgency and nearness, rather than at random."""
    greed: float = 6.0
    """Greatest power of that preference."""
    scatter_au: float = 0.05
    """How far from a particle a goal may be."""
    refine_au: float = 0.05
    """Typical change of a goal in refinement."""
    unfound_weight: float = 10.0
    """Weight of a target that was never seen: once found, it can be followed.

    While more targets may exist than are known, an imagined one has this weight too.
    """
    motion: MotionSettings = field(default_factory=MotionSettings)

    @property
    def effort(self) -> paths.Effort:
        """What the compiled search needs to draw candidates."""
        return paths.Effort(
            num_drawn=self.num_drawn,
            num_refined=self.num_refined,
            guided_share=self.guided_share,
            greed=self.greed,
            forget_steps=self.forget_steps,
            refine_au=self.refine_au,
            scatter_au=self.scatter_au,
        )

    def horizon(self, speed: float) -> int:
        """Measurements to look ahead over, for targets of a speed."""
        return min(self.num_steps, math.ceil(self.walk_au / speed / MEASUREMENT_INTERVAL_AU))

    def tables(self, speed: float) -> scoring.Tables:
        """Look-up tables of the score for targets of a speed."""
        return scoring.make_tables(
            speed=speed,
            num_steps=self.horizon(speed),
            discount=self.discount,
            fading=self.fading,
            drift=self.drift,
            probe_au=self.probe_au,
            sight_gain=self.sight_gain,
            forget_steps=self.forget_steps,
            shape_worth=self.shape_worth,
        )


class _Evidence:
    """What each target's Gaussian process was given within its window."""

    def __init__(self, priors_au: FloatArray) -> None:
        self._measurements: deque[Measurement] = deque()
        self._priors = [
            [] if np.isnan(prior_au).any() else [(*prior_au, 0.0)] for prior_au in priors_au
        ]
        self.seen_au = [-math.inf if np.isnan(p).any() else 0.0 for p in priors_au]

    def add_target(self) -> None:
        """Append a target without prior."""
        self._priors.append([])
        self.seen_au.append(-math.inf)

    def add(self, measurement: Measurement) -> None:
        """Take a measurement and forget those that leave the window."""
        self._measurements.append(measurement)
        while measurement.time_au - self._measurements[0].time_au >= WINDOW_AU:
            self._measurements.popleft()
        for index in np.flatnonzero(measurement.seen):
            self.seen_au[index] = measurement.time_au

    def due_au(self, time_au: float) -> float:
        """Distance to a measurement that is worth planning for: the next, or the one after."""
        latest_au = self._measurements[-1].time_au if self._measurements else 0.0
        left = until_measurement_au(time_au - latest_au)
        return left if left >= _NEXT_AU else left + MEASUREMENT_INTERVAL_AU

    def points(self, time_au: float, num_targets: int) -> tuple[FloatArray, FloatArray, IntArray]:
        """Each target's data, and how many. -> (N, n, 3) x, y, time; (N, n) presence; (N,)."""
        num_points = len(self._measurements)
        points = np.zeros((num_targets, num_points + 1, 3))
        values = np.zeros((num_targets, num_points + 1))
        for m, measurement in enumerate(self._measurements):
            points[:, m, :2] = measurement.agent_au
            points[:, m, 2] = measurement.time_au
            for seen in measurement.seen.nonzero()[0]:
                points[seen, m, :2] = measurement.target_au[seen]
                values[seen, m] = 1.0
        counts = np.full(num_targets, num_points)
        for i, prior in enumerate(self._priors):
            if prior and time_au < WINDOW_AU:
                points[i, num_points] = prior[0]
                values[i, num_points] = 1.0
                counts[i] += 1
        return points, values, counts


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
        self._may_be_more = briefing.num_targets == 0
        priors_au = briefing.priors_au.reshape(-1, 2)
        if self._may_be_more:
            priors_au = np.full((1, 2), np.nan)  # the imagined target, always the last
        self._belief = ParticleBelief(priors_au, self.settings.motion, self._rng)
        self._evidence = _Evidence(priors_au)
        self._ground = self._make_ground(roadmap)
        self._goals = np.zeros((paths.MAX_GOALS, 2))
        self._num_goals = 0

    def _make_ground(self, roadmap: Roadmap) -> moving.Ground:
        """Free flight: no nodes."""
        return moving.Ground(
            nodes=np.empty((0, 2)),
            next_hop=np.empty((0, 0), dtype=np.int64),
            nearest=np.empty((0, 0), dtype=np.int64),
        )

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """One step along the best path found."""
        self._learn(snapshot.measurements, snapshot.time_au)
        start = paths.Start(
            float(snapshot.position_au[0]),
            float(snapshot.position_au[1]),
            -1,
            self._evidence.due_au(snapshot.time_au),
        )
        found = self._search(snapshot.time_au, start, np.empty(0, dtype=np.int64))
        path_au = found.path_au
        if not _is_found(found.gain) or math.dist(path_au[0], snapshot.position_au) <= ARRIVED_AU:
            raise PlannerError(f"search found no path from {snapshot.position_au}; report this")
        self._keep(found, path_au[0])
        return Waypoint(
            position_au=path_au[0],
            details={
                "gain": found.gain,
                "speed": self._belief.speed.mean,
                "path": path_au.tolist(),
            },
        )

    def _keep(self, found: paths.Found, reached_au: FloatArray) -> None:
        """Remember the best path's goals, less those that the next waypoint reaches."""
        done, count = 0, found.num_goals
        while done < count and math.dist(found.goals_au[done], reached_au) < 0.05:
            done += 1
        self._num_goals = count - done
        self._goals[: self._num_goals] = found.goals_au[done:count]

    def _learn(self, measurements: tuple[Measurement, ...], time_au: float) -> None:
        for measurement in measurements:
            while len(measurement.seen) > len(self._belief.tracks) - self._may_be_more:
                self._belief.add_target()
                self._evidence.add_target()
            self._belief.update(measurement)
            self._evidence.add(measurement)
        self._belief.advance(time_au)

    def _foreseen(self, time_au: float) -> tuple[FloatArray, FloatArray, float]:
        """Give the particles now and at the next measurements, and their speed.

        -> (N, m, 2), (H, N, m, 2), ratio to the agent's
        """
        speed = self._belief.speed.mean
        count = self.settings.num_planned_in_all // len(self._belief.tracks)
        now, later = self._belief.futures(
            min(self.settings.num_planned, count),
            self.settings.horizon(speed),
            MEASUREMENT_INTERVAL_AU,
        )
        return now, later, speed

    def _search(self, time_au: float, start: paths.Start, options: IntArray) -> paths.Found:
        now, later, speed = self._foreseen(time_au)
        num_targets, num_each = now.shape[:2]
        tables = self.settings.tables(speed)
        first = np.arange(num_targets + 1) * num_each
        points, values, counts = self._evidence.points(time_au, num_targets)
        mean = np.empty((num_targets, scoring.MEAN_CELLS, scoring.MEAN_CELLS), dtype=np.float32)
        scoring.mean_fields(points, values, counts, time_au, mean)
        probe_age = np.empty((num_targets * num_each, 4), dtype=np.int32)
        scoring.probe_ages(
            np.ascontiguousarray(now.reshape(-1, 2)),
            first,
            points,
            counts,
            time_au,
            tables,
            probe_age,
        )
        since = (time_au - np.array(self._evidence.seen_au)) / MEASUREMENT_INTERVAL_AU
        weight = np.full(num_targets, 1.0 / num_each)
        weight[np.isinf(since)] *= self.settings.unfound_weight
        flat = later.astype(np.float32).reshape(len(later), -1, 2)
        forecast = scoring.Forecast(
            x=np.ascontiguousarray(flat[..., 0]),
            y=np.ascontiguousarray(flat[..., 1]),
            weight=np.repeat(weight, num_each).astype(np.float32),
            probe_age=probe_age,
            sight_age=np.repeat(np.rint(since.clip(0, scoring.OLDEST)), num_each).astype(np.int32),
            first=first,
            mean=mean,
        )
        found: paths.Found = paths.search(
            start,
            self._ground,
            options,
            forecast,
            tables,
            self.settings.effort,
            self._goals,
            self._num_goals,
            self._rng,
        )
        return found


class RoadmapSearchPlanner(SearchPlanner):
    """Decides at roadmap nodes, as the learned policy does; its teacher."""

    name = "search-roadmap"

    def _make_ground(self, roadmap: Roadmap) -> moving.Ground:
        """Shortest paths, and the node nearest to each cell of the square."""
        centres = (np.arange(moving.NEAREST_CELLS) + 0.5) / moving.NEAREST_CELLS
        offset: FloatArray = np.stack(np.meshgrid(centres, centres, indexing="ij"), axis=-1)[
            :, :, None
        ]
        distance = np.linalg.norm(offset - roadmap.nodes_au, axis=-1)
        return moving.Ground(
            nodes=np.ascontiguousarray(roadmap.nodes_au),
            next_hop=roadmap.next_hop,
            nearest=distance.argmin(axis=-1),
        )

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """The neighbour by way of which the best path goes; details hold every neighbour's gain."""
        self._learn(snapshot.measurements, snapshot.time_au)
        nodes_au = snapshot.roadmap.nodes_au
        node = snapshot.node
        if node is None:
            node = int(np.linalg.norm(nodes_au - snapshot.position_au, axis=-1).argmin())
        neighbours = snapshot.roadmap.neighbours[node]
        neighbours = neighbours[neighbours != node]
        start = paths.Start(
            float(snapshot.position_au[0]),
            float(snapshot.position_au[1]),
            node,
            until_measurement_au(snapshot.time_au),
        )
        found = self._search(snapshot.time_au, start, neighbours)
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


def _is_found(gain: float) -> bool:
    return math.isfinite(gain) and gain > paths.NOTHING


@cache
def _compile() -> None:
    """Have all compiled code ready, by a decision that is thrown away."""
    planner = SearchPlanner()
    start_au = np.array([0.5, 0.5])
    planner._begin(
        Briefing(
            num_targets=1,
            priors_au=start_au[None],
            start_au=start_au,
            horizon_au=1.0,
            rng=np.random.default_rng(0),
        ),
        Roadmap(nodes_au=start_au[None], neighbours=np.zeros((1, 1), dtype=np.int64)),
    )
    for time_au in (
        0.1,
        0.2,
    ):  # misses where the target must be, so that all particles are replaced
        missed = Measurement(
            time_au=time_au,
            agent_au=start_au,
            seen=np.array([False]),
            target_au=np.full((1, 2), np.nan),
        )
        planner._learn((missed,), time_au)
    planner._search(0.2, paths.Start(0.5, 0.5, -1, 0.1), np.empty(0, dtype=np.int64))
