"""What every planner is given and gives: a snapshot of the mission in, the next waypoint out.

A planner is asked whenever the agent reaches the waypoint it gave last, and first at the start. It
works in au, where the agent flies one au in one unit of time, and it may name any place of the
arena: a far one (a lawnmower's next turn) or a near one (a search that plans anew every 0.1 au).
The agent cannot stop: a waypoint nearer than 1e-6 au is an error of the planner, and so is one
outside the arena.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from dronemon.arena import ARENA, Arena
from dronemon.sensor import PERFECT, Sensor
from dronemon.types import FloatArray

if TYPE_CHECKING:
    from dronemon.belief import Belief
    from dronemon.policy import Explanation
    from dronemon.roadmap import Roadmap
    from dronemon.sightings import Sightings

TargetsAt = Callable[[FloatArray], FloatArray]
"""True positions of all targets at given times. (S,) au -> (S, N, 2) au."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """What is known when a waypoint is due.

    time_au:      mission time; what is known ages by it
    flown_au:     distance flown; measurements come by it. The same where one flies at unit speed
    position_au:  (2,) au the agent's
    node:         the roadmap node it stands on, if any
    sightings:    the mission's log, which grows on after the decision
    belief:       posteriors of all known targets; fitted when asked, so it costs nothing unused
    remaining_au: distance left to fly

    Without any prior the number of targets grows: one that is seen for the first time is appended.
    """

    time_au: float
    flown_au: float
    position_au: FloatArray
    node: int | None
    sightings: Sightings
    belief: Belief
    roadmap: Roadmap
    remaining_au: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    """Where to fly next, in a straight line.

    position_au: (2,); node: its roadmap node, if it is one; details: what the planner thought, JSON
    values only, for the record
    """

    position_au: FloatArray
    node: int | None = None
    details: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Briefing:
    """What is known before the mission starts, or goes on.

    num_targets: N known so far
    priors_au:   (N, 2) au positions at time 0, NaN where unknown
    start_au:    (2,) au
    horizon_au:  distance to fly
    rng:         the planner's own randomness
    arena:       where waypoints may be
    sensor:      how the eye errs
    sightings:   what was seen before, where a mission goes on: to be taken in before take-off
    """

    num_targets: int
    priors_au: FloatArray
    start_au: FloatArray
    horizon_au: float
    rng: np.random.Generator
    arena: Arena = ARENA
    sensor: Sensor = PERFECT
    sightings: Sightings | None = None

    @property
    def num_imagined(self) -> int:
        """Targets to imagine, in place of all that may exist unknown: one where none is told of."""
        return int(self.num_targets == 0)


class Planner(Protocol):
    """Chooses waypoints. One object flies many missions, one after another; `reset` begins each."""

    @property
    def name(self) -> str:
        """What tables and records call it; also its name in the registry."""
        ...

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        """Forget the last mission and begin a new one."""
        ...

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """Where to go from here."""
        ...


@runtime_checkable
class Explaining(Protocol):
    """A planner that can say what it looked at."""

    def explanation(self) -> Explanation:
        """The weights of attention behind the newest waypoint."""
        ...


@runtime_checkable
class Clairvoyant(Protocol):
    """A planner that is told where the targets are and will be: a bound for others, never flown."""

    def foresee(self, targets_at: TargetsAt) -> None:
        """Take the truth of the next mission; `dronemon.evaluation` calls this before `reset`."""
        ...
