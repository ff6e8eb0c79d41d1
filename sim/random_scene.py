"""Random scenes over random areas, for whoever trains or measures a detector."""

from __future__ import annotations

import math

import numpy as np

from dronemon.frames import AreaFrame
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import ANIMALS, Pose
from sim.scene import Animal, Scene
from sim.sprites import drawn_size_m

SIDE_M = 200.0
_HEIGHT_M = 35.0
_MAX_TILT_RAD = math.radians(15.0)


def random_scene(
    rng: np.random.Generator,
    height_m: float | None = None,
    *,
    appearances: tuple[str, ...] = ANIMALS,
    reach: float = 1.0,
    num_near: int = 1,
    max_tilt_rad: float = _MAX_TILT_RAD,
) -> Scene:
    """A scene with `num_near` targets within `reach` sensor radii and the others anywhere."""
    side_m = SIDE_M if height_m is None else SIDE_M * height_m / _HEIGHT_M
    frame = AreaFrame(
        centre_ned_m=(rng.uniform(-300.0, 300.0), rng.uniform(-300.0, 300.0)),
        ground_down_m=rng.uniform(-5.0, 5.0),
        side_m=side_m,
        heading_rad=rng.uniform(-math.pi, math.pi),
        cruise_speed_m_s=5.0,
    )
    north_m, east_m = frame.au_to_ned(rng.uniform(0.0, 1.0, 2))
    tilt_rad, towards = max_tilt_rad * math.sqrt(rng.uniform()), rng.uniform(-math.pi, math.pi)
    if height_m is None:
        height_m = _HEIGHT_M * rng.uniform(0.8, 1.2)
    pose = Pose(
        time_s=rng.uniform(0.0, 1000.0),
        position_ned_m=(north_m, east_m, frame.ground_down_m - height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=(
            tilt_rad * math.sin(towards),
            tilt_rad * math.cos(towards),
            rng.uniform(-math.pi, math.pi),
        ),
    )
    near = rng.permutation(len(appearances))[:num_near]
    animals: list[Animal] = []
    for i, appearance in enumerate(appearances):
        at_m = frame.au_to_ned(rng.uniform(0.0, 1.0, 2))
        if i in near:
            reach_m, bearing = reach * SENSOR_RADIUS_AU * side_m, rng.uniform(0.0, math.tau)
            at_m = np.array([north_m, east_m]) + reach_m * math.sqrt(rng.uniform()) * np.array(
                [math.cos(bearing), math.sin(bearing)]
            )
        animal = Animal(
            name=appearance,
            appearance=appearance,
            position_ned_m=(at_m[0], at_m[1]),
            heading_rad=rng.uniform(-math.pi, math.pi),
            walked_m=rng.uniform(0.0, 100.0),
        )
        if not any(_touch(animal, other) for other in animals):
            animals.append(animal)
    return Scene(pose=pose, frame=frame, animals=tuple(animals))


def _touch(one: Animal, other: Animal) -> bool:
    """Whether two may be drawn one over the other."""
    lengths_m = [drawn_size_m(animal.appearance)[0] for animal in (one, other)]
    return math.dist(one.position_ned_m, other.position_ned_m) < 0.5 * sum(lengths_m)
