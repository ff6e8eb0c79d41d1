"""Episodes of `dronemon.env.Env` with observations of a fixed shape, in Gymnasium's spaces.

B: episodes; V: nodes, the start among them; K: ways to go on from a node; N: targets
"""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray

from dronemon.arena import ARENA
from dronemon.env import Env, Observation, Setup
from dronemon.errors import OptionError
from dronemon.gym.picture import draw
from dronemon.gym.scene import Scene, Shown
from dronemon.policy.tracks import NUM_TRACK_FEATURES
from dronemon.problem import FIRST_TRAINING_SEED, MAX_TARGETS, Prior
from dronemon.roadmap import MAX_ADDED_NEIGHBOURS
from dronemon.types import FloatArray, ImageArray

try:
    from gymnasium import error, spaces
except ImportError as exc:
    raise ImportError(
        "dronemon.gym needs Gymnasium, which is not installed: pip install 'dronemon[gym]'"
    ) from exc

Action = Literal["neighbour", "waypoint"]
_MOST_NODES, _MOST_THREADS = 2000, 256
_ANY = float(np.finfo(np.float32).max)
"""Where no bound is known."""


class Episodes:
    """B episodes on the same terms, which decide in step.

    num_targets:    N; with prior `none` there is one more column, the last, of a target imagined
    num_nodes:      of the roadmap, the start not counted: V - 1
    speed_ratio:    the targets' speed over the agent's
    prior:          known at the start: places of all targets (`full`), their `number`, or `none`
    num_neighbours: nearest nodes that a node is joined to, itself counted
    action:         what is chosen: a `neighbour` on the roadmap, or any `waypoint`
    num_threads:    share the beliefs' work, as `Env` has it

    Raises OptionError if a term cannot be.
    """

    def __init__(
        self,
        *,
        num_targets: int = 4,
        num_nodes: int = 200,
        speed_ratio: float = 0.1,
        prior: Prior = "full",
        num_neighbours: int = 10,
        action: Action = "neighbour",
        num_threads: int = 1,
    ) -> None:
        check_count("num_targets", num_targets, 1, MAX_TARGETS)
        check_count("num_nodes", num_nodes, 1, _MOST_NODES)
        check_count("num_neighbours", num_neighbours, 2, _MOST_NODES)
        check_count("num_threads", num_threads, 1, _MOST_THREADS)
        num_targets, num_nodes, num_neighbours = map(int, (num_targets, num_nodes, num_neighbours))
        is_slower = isinstance(speed_ratio, Real) and 0.0 <= speed_ratio < 1.0
        _check("speed_ratio", is_slower, speed_ratio, "from 0 to below 1, the agent's speed")
        _check("prior", prior in get_args(Prior), prior, "full, number or none")
        _check("action", action in get_args(Action), action, "neighbour or waypoint")
        self._terms: dict[str, Any] = {
            "num_targets": num_targets,
            "num_nodes": num_nodes,
            "speed_ratio": speed_ratio,
            "prior": prior,
        }
        self._num_ways = min(num_neighbours - 1, num_nodes) + MAX_ADDED_NEIGHBOURS
        self._num_targets = num_targets
        self._env = Env(num_neighbours=num_neighbours, num_threads=num_threads)
        self._last: Observation | None = None
        self.observation_space: spaces.Space[Any] = self._spaces(
            num_nodes + 1, num_targets + int(prior == "none")
        )
        low, high = ARENA.bounds
        self.action_space: spaces.Space[Any] = (
            spaces.Discrete(self._num_ways)
            if action == "neighbour"
            else spaces.Box(low, high, dtype=np.float64)
        )

    @property
    def _seen(self) -> Observation:
        """What was observed last. Raises ResetNeeded before any episode."""
        if self._last is None:
            raise error.ResetNeeded("call reset first")
        return self._last

    def begin(self, seeds: Sequence[int]) -> Shown:
        """Begin the episodes of some seeds: those that `Env` draws from the same ones."""
        seen = self._env.reset([Setup(seed=seed, **self._terms) for seed in seeds])
        graphs = self._env.graphs
        self._scene = Scene(
            graphs.coordinates.numpy(),
            graphs.neighbours.numpy(),
            graphs.neighbour_mask.numpy(),
            self._num_ways,
        )
        return self._show(seen)

    def step(self, actions: NDArray[Any]) -> tuple[Shown, FloatArray, list[dict[str, Any]]]:
        """Fly where the actions lead. -> what is observed, (B,) rewards, what else to tell of each.

        actions: (B,) int, a way to go: there being m of them, way a is that of number a mod m;
                 or (B, 2) au, a place
        """
        before_au = self._seen.length_au
        if isinstance(self.action_space, spaces.Box):
            step = self._env.step_to(torch.as_tensor(actions))
        else:
            nodes = self._scene.follow(self._seen.node.numpy(), actions)
            step = self._env.step(torch.as_tensor(nodes))
        shown = self._show(step.observation)
        area_std = step.area_std[:, : self._num_targets].numpy().copy()
        legs_au = (step.observation.length_au - before_au).tolist()
        told = [
            {"area_std": std, "leg_au": leg} for std, leg in zip(area_std, legs_au, strict=True)
        ]
        return shown, step.reward.numpy(), told

    def draw(self) -> list[ImageArray]:
        """A picture of each episode."""
        return draw(self._env, self._seen, self._num_targets)

    def _show(self, seen: Observation) -> Shown:
        """What is observed, in new arrays."""
        self._last = seen
        return self._scene.show(
            node=seen.node.numpy(),
            position_au=seen.position_au.numpy(),
            time_au=seen.length_au.numpy(),
            belief=seen.frames.numpy(),
            target_mask=seen.target_mask.numpy(),
            tracks=seen.tracks.numpy(),
        )

    def _spaces(self, num_nodes: int, num_targets: int) -> spaces.Dict:
        """Of one episode's observation."""
        low, high = ARENA.bounds.astype(np.float32)
        nodes_shape, ways_shape = (num_nodes, 2), (num_nodes, self._num_ways)
        belief_shape = (num_nodes, num_targets, 4)
        # Mean and standard deviation now and later:
        least, most = np.array([[-_ANY, 0.0] * 2, [_ANY, 1.0] * 2], dtype=np.float32)
        return spaces.Dict(
            {
                "position_au": spaces.Box(low, high),
                "time_au": spaces.Box(0.0, _ANY, (1,)),
                "nodes_au": spaces.Box(
                    np.broadcast_to(low, nodes_shape), np.broadcast_to(high, nodes_shape)
                ),
                "neighbours": spaces.Box(0, num_nodes - 1, ways_shape, dtype=np.int64),
                "node": spaces.Discrete(num_nodes),
                "neighbour_mask": spaces.MultiBinary(self._num_ways),
                "belief": spaces.Box(
                    np.broadcast_to(least, belief_shape), np.broadcast_to(most, belief_shape)
                ),
                "target_mask": spaces.MultiBinary(num_targets),
                "tracks": spaces.Box(-_ANY, _ANY, (num_targets, NUM_TRACK_FEATURES)),
            }
        )


def drawn_seed(rng: np.random.Generator) -> int:
    """Seed of an episode for which none is given: one of those for training."""
    return FIRST_TRAINING_SEED + int(rng.integers(2**31))


def check_count(name: str, value: object, least: int, most: int) -> None:
    """Refuse what is no whole number from least to most. Raises OptionError."""
    is_count = isinstance(value, Integral) and not isinstance(value, bool)
    is_possible = is_count and least <= value <= most  # type: ignore[operator]
    _check(name, is_possible, value, f"a whole number from {least} to {most}")


def _check(name: str, is_possible: bool, value: object, possible: str) -> None:
    if not is_possible:
        raise OptionError(f"{name} is {value!r}; it can be {possible}")
