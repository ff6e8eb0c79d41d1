"""One seed is one instance: the agent's start, the targets' paths, and named random streams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dronemon.arena import ARENA, Arena
from dronemon.types import FloatArray
from dronemon.world.motions import draw_paths
from dronemon.world.targets import TargetPaths


def named_stream(seed: int, name: str) -> np.random.Generator:
    """Return one purpose's generator: fixed by seed and name, unmoved by other streams."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(name.encode())))


@dataclass(frozen=True, slots=True, kw_only=True)
class Instance:
    """One problem: where the agent starts and along which paths the targets walk.

    start_au: (2,) au
    arena:    where that is
    """

    seed: int
    start_au: FloatArray
    paths: TargetPaths
    arena: Arena = ARENA

    @classmethod
    def draw(
        cls,
        seed: int,
        num_targets: int,
        motion: str = "tsp",
        speed_spread: float = 0.0,
        arena: Arena = ARENA,
    ) -> Instance:
        """Draw a seed's instance; its first targets do not depend on how many there are.

        motion:       see `dronemon.world.motions`; OptionError where it is a file of no use
        speed_spread: targets are up to this share faster or slower than the others take them to be
        """
        paths = draw_paths(motion, num_targets, named_stream(seed, "targets"), arena)
        spread = named_stream(seed, "speeds").uniform(-speed_spread, speed_spread, num_targets)
        return cls(
            seed=seed,
            start_au=arena.sample_free(1, named_stream(seed, "start"))[0],
            paths=paths.at_speeds(1.0 + spread) if speed_spread else paths,
            arena=arena,
        )

    def stream(self, name: str) -> np.random.Generator:
        """Fresh generator of one purpose, such as `roadmap` or `planner`."""
        return named_stream(self.seed, name)
