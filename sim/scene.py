"""What the simulated camera looks at: the vehicle's pose and the animals, at one instant."""

from __future__ import annotations

from dataclasses import dataclass

from dronemon.frames import AreaFrame
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
