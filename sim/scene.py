"""What the simulated camera looks at: the vehicle's pose and the animals, at one instant."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, replace

from dronemon.frames import AreaFrame
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class Animal:
    """One animal at one instant. `walked_m` moves its legs; `position_ned_m` is (north, east)."""

    name: str
    appearance: str
    position_ned_m: tuple[float, float]
    heading_rad: float
    walked_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything a picture depends on, at the instant of the pose."""

    pose: Pose
    frame: AreaFrame
    animals: tuple[Animal, ...]


def with_faults(scene: Scene, faults: Mapping[str, float], rng: random.Random) -> Scene:
    """The scene as a picture shows it: with animals out of sight, or one that is not there.

    faults: kinds that are active now -> value
    """
    animals = [a for a in scene.animals if rng.random() >= faults.get("hide", 0.0)]
    if rng.random() < faults.get("decoy", 0.0):
        north_m, east_m, _ = scene.pose.position_ned_m
        away_m = SENSOR_RADIUS_AU * scene.frame.side_m * math.sqrt(rng.random())
        way_rad, heading_rad = rng.uniform(0.0, math.tau), rng.uniform(0.0, math.tau)
        place = north_m + away_m * math.cos(way_rad), east_m + away_m * math.sin(way_rad)
        like = rng.choice(scene.animals)
        animals.append(replace(like, position_ned_m=place, heading_rad=heading_rad))
    return replace(scene, animals=tuple(animals))
