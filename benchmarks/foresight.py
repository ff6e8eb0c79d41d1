"""How well particles foresee where targets are: `benchmarks/foresight.py [NAME=VALUE ...]`.

The search flies development instances (seeds 10000 and up); what it saw is then told to particles
with the settings of `SearchSettings`, and with each change given (as in `tune_search.py`). Prints
the mean log of their density at the true place of every target out of view, and the paired
difference. All are told of the same flights: that tells beliefs apart that flown scores do not.
"""

from __future__ import annotations

import argparse

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # has no types
from tune_search import changed

from dronemon.evaluation.episode import Conditions, Episode, fly_episode
from dronemon.planner.particles import ParticleBelief
from dronemon.planner.search import SearchPlanner
from dronemon.planner.settings import MotionSettings
from dronemon.problem import FIRST_DEVELOPMENT_SEED
from dronemon.sightings import Sightings
from dronemon.types import FloatArray
from dronemon.world import Instance, measure

_WIDTH_AU = 0.04
"""Of the kernel about each particle."""
_ASTRAY = 0.02
"""Density per au^2 that is left for where no particle is: the log has a floor."""
_UNSEEN_AU = 0.15
"""Time since its last sight from which a target counts: two pictures in a row without it."""


def density(particles_au: FloatArray, place_au: FloatArray) -> float:
    """Density per au^2 that particles (M, 2) give a place (2,)."""
    squared = ((particles_au - place_au) ** 2).sum(axis=1)
    near = np.exp(-0.5 * squared / _WIDTH_AU**2).mean() / (2.0 * np.pi * _WIDTH_AU**2)
    return float((1.0 - _ASTRAY) * near + _ASTRAY)


def foreseen(episode: Episode, motion: MotionSettings, rng: np.random.Generator) -> float:
    """Mean log density of particles at the targets out of view, told what an episode saw."""
    sightings = Sightings(episode.targets_au[0])
    belief = ParticleBelief(sightings.priors_au, motion, rng)
    densities: list[float] = []
    for k, time_au in enumerate(episode.conditions.times_au[1:].tolist(), start=1):
        belief.advance(time_au)
        densities += (
            density(belief.targets[i].walkers[:, :2], episode.targets_au[k, i])
            for i in np.flatnonzero(time_au - sightings.last_seen_au > _UNSEEN_AU)
        )
        sightings.add(measure(time_au, episode.agent_au[k], episode.targets_au[k]))
        belief.learn(sightings)
    return float(np.log(densities).mean())


def main() -> None:
    """Fly, and tell what was seen to each belief."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("changes", nargs="*", help="NAME=VALUE[,NAME=VALUE ...]")
    parser.add_argument("--targets", type=int, default=4)
    parser.add_argument("--speed", type=float, default=1 / 7, help="over the agent's")
    parser.add_argument("--motion", default="tsp", help="as of `dronemon evaluate`")
    parser.add_argument("--instances", type=int, default=24)
    arguments = parser.parse_args()
    conditions = Conditions(speed_ratio=arguments.speed)
    logs: dict[str, list[float]] = {change: [] for change in ("", *arguments.changes)}
    with threadpool_limits(1):
        for seed in range(FIRST_DEVELOPMENT_SEED, FIRST_DEVELOPMENT_SEED + arguments.instances):
            instance = Instance.draw(seed, arguments.targets, arguments.motion)
            episode = fly_episode(SearchPlanner(), instance, conditions)
            for change, values in logs.items():
                rng = np.random.default_rng(seed)
                values.append(foreseen(episode, changed(change).motion, rng))
    base = np.array(logs[""])
    error = 1.0 / np.sqrt(max(len(base) - 1, 1))
    print(f"{'as it is':40s} {base.mean():.3f} ± {base.std() * error:.3f}")
    for change in arguments.changes:
        gain = np.array(logs[change]) - base
        print(f"{change:40s} {gain.mean():+.3f} ± {gain.std() * error:.3f}")


if __name__ == "__main__":
    main()
