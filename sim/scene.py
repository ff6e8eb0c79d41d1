"""What the simulated camera looks at: its pose and the targets, at one instant."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, replace

from dronemon.frames import AreaFrame
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import Obstacle, Pose, Vector3


@dataclass(frozen=True, slots=True, kw_only=True)
class Animal:
    """One animal, or a person or vehicle, at one instant. `position_ned_m` is (north, east).

    walked_m: moves its legs
    up_m:     the ground there, above that below the camera
    """

    name: str
    appearance: str
    position_ned_m: tuple[float, float]
    heading_rad: float
    walked_m: float
    up_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything a picture depends on, at the instant of the pose.

    frame: of the area, laid over the ground below the camera
    """

    pose: Pose
    frame: AreaFrame
    animals: tuple[Animal, ...]
    turn_rad_s: Vector3 = (0.0, 0.0, 0.0)
    """Rates of the angles of the pose's attitude."""
    obstacles: tuple[tuple[Obstacle, float], ...] = ()
    """What stands there, and how far its foot is above the ground below the camera."""

    def pose_after(self, time_s: float) -> Pose:
        """The pose a little later, or earlier."""
        at_m, way_m_s = self.pose.position_ned_m, self.pose.velocity_ned_m_s
        north, east, down = (x + time_s * v for x, v in zip(at_m, way_m_s, strict=True))
        angles = zip(self.pose.attitude_rad, self.turn_rad_s, strict=True)
        roll, pitch, yaw = (x + time_s * rate for x, rate in angles)
        return replace(
            self.pose, position_ned_m=(north, east, down), attitude_rad=(roll, pitch, yaw)
        )


def with_faults(scene: Scene, faults: Mapping[str, float], rng: random.Random) -> Scene:
    """The scene as a picture shows it: animals out of sight, astray or mistaken, or one too many.

    faults: kinds that are active now -> value
    """
    looks = sorted({animal.appearance for animal in scene.animals})
    off_m, share = faults.get("misplace", 0.0), faults.get("mistake", 0.0)
    animals = []
    for animal in scene.animals:
        if rng.random() < faults.get("hide", 0.0):
            continue
        north_m, east_m = animal.position_ned_m
        place = north_m + rng.gauss(0.0, off_m), east_m + rng.gauss(0.0, off_m)
        others = [look for look in looks if look != animal.appearance]
        look = rng.choice(others) if others and rng.random() < share else animal.appearance
        animals.append(replace(animal, position_ned_m=place, appearance=look))
    if rng.random() < faults.get("decoy", 0.0):
        north_m, east_m, _ = scene.pose.position_ned_m
        away_m = SENSOR_RADIUS_AU * scene.frame.side_m * math.sqrt(rng.random())
        way_rad, heading_rad = rng.uniform(0.0, math.tau), rng.uniform(0.0, math.tau)
        place = north_m + away_m * math.cos(way_rad), east_m + away_m * math.sin(way_rad)
        like = rng.choice(scene.animals)
        animals.append(replace(like, position_ned_m=place, heading_rad=heading_rad))
    return replace(scene, animals=tuple(animals))
