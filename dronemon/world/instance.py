"""One seed is one instance: the agent's start, the targets' paths, and named random streams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dronemon.arena import ARENA
from dronemon.types import FloatArray
from dronemon.world.targets import TargetPaths


def named_stream(seed: int, name: str) -> np.random.Generator:
    """Return one purpose's generator: fixed by seed and name, unmoved by other streams."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(name.encode())))


@dataclass(frozen=True, slots=True, kw_only=True)
class Instance:
    """One problem: where the agent starts and along which paths the targets walk.

    start_au: (2,) au
    """

    seed: int
    start_au: FloatArray
    paths: TargetPaths

    @classmethod
    def draw(cls, seed: int, num_targets: int) -> Instance:
        """Draw a seed's instance; its first targets do not depend on how many there are."""
        return cls(
            seed=seed,
            start_au=ARENA.sample(1, named_stream(seed, "start"))[0],
            paths=TargetPaths.random(num_targets, named_stream(seed, "targets")),
        )

    def stream(self, name: str) -> np.random.Generator:
        """Fresh generator of one purpose, such as `roadmap` or `planner`."""
        return named_stream(self.seed, name)
