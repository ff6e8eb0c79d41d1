"""What every planner is given and gives: a snapshot of the mission in, the next waypoint out.

A planner is asked whenever the agent reaches the waypoint it gave last, and first at the start. It
works in unit-square lengths, where the agent flies one au in one unit of time, and it may name any
point of the square: a far one (a lawnmower's next turn) or a near one (a search that plans anew
every 0.1 au). The agent cannot stop: a waypoint nearer than 1e-6 au is an error of the planner.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from dronemon.types import FloatArray, Measurement

if TYPE_CHECKING:
    from dronemon.belief import Belief
    from dronemon.roadmap import Roadmap

TargetsAt = Callable[[FloatArray], FloatArray]
"""True positions of all targets at given times. (S,) au -> (S, N, 2) au."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """What is known when a waypoint is due.

    time_au: mission time, which is the distance flown; position_au: (2,) the agent's; node: the
    roadmap node it stands on, if any; measurements: all since the previous snapshot, oldest first;
    remaining_au: mission time left.

    Index i always means the same target. Without any prior the number of targets grows: a target
    that is seen for the first time is appended, and later measurements are longer than earlier
    ones.
    """

    time_au: float
    position_au: FloatArray
    node: int | None
    measurements: tuple[Measurement, ...]
    belief: Belief
    """Posteriors of all known targets; built when first asked, so it costs nothing unused."""
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
    """What is known before the mission starts.

    num_targets: N known so far; priors_au: (N, 2) positions at time 0, NaN where unknown; start_au:
    (2,); horizon_au: mission length; rng: the planner's own randomness. Sensor radius and
    measurement interval are constants of `dronemon.mission.schema`.
    """

    num_targets: int
    priors_au: FloatArray
    start_au: FloatArray
    horizon_au: float
    rng: np.random.Generator


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
class Clairvoyant(Protocol):
    """A planner that is told where the targets are and will be: a bound for others, never flown."""

    def foresee(self, targets_at: TargetsAt) -> None:
        """Take the truth of the next mission; `dronemon.evaluation` calls this before `reset`."""
        ...
