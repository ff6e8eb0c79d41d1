"""Values that cross layers, all immutable. Arrays are float64 unless they say otherwise.

Units are the last word of a name: `_au` unit-square lengths (and the time in which one is flown),
`_m`, `_s`, `_rad`, `_px`;
a frame comes with it: `_ned_m` is north, east, down in metres from the vehicle's local origin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

from dronemon.problem import SENSOR_RADIUS_AU

if TYPE_CHECKING:  # numpy is slow to import, and a mission's check needs only its own numbers
    import numpy as np
    from numpy.typing import NDArray

FloatArray: TypeAlias = "NDArray[np.float64]"
BoolArray: TypeAlias = "NDArray[np.bool_]"
IntArray: TypeAlias = "NDArray[np.int64]"
ImageArray: TypeAlias = "NDArray[np.uint8]"
Vector3 = tuple[float, float, float]
GRAVITY_M_S2 = 9.80665
ANIMALS = ("cow", "deer", "fox", "horse", "panda", "sheep", "tiger", "zebra")
PEOPLE = ("person-blue", "person-orange", "person-pink", "person-red", "person-yellow")
VEHICLES = (
    *("bus-red", "bus-yellow"),
    *("car-black", "car-blue", "car-red", "car-white", "car-yellow"),
    *("truck-blue", "truck-white", "van-blue", "van-white"),
)
APPEARANCES = (*ANIMALS, *PEOPLE, *VEHICLES)
"""What the simulator draws and the drawn detector tells apart."""
Layout = Literal["yolov5", "yolov8", "yolov10", "rtdetr", "rtdetr-top", "detr"]
"""How a network's outputs hold boxes: see `dronemon.vision.layouts`."""
LAYOUTS: tuple[Layout, ...] = get_args(Layout)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Where the vehicle is, how it moves and how it is tilted, at one instant of vehicle time."""

    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    attitude_rad: Vector3
    """Roll, pitch, yaw: rotations about forward, right, down (aerospace ZYX order)."""

    @classmethod
    def level(cls, height_m: float) -> Pose:
        """Still and level, north ahead, at a height over the origin."""
        still = (0.0, 0.0, 0.0)
        return cls(
            time_s=0.0,
            position_ned_m=(0.0, 0.0, -height_m),
            velocity_ned_m_s=still,
            attitude_rad=still,
        )

    @property
    def ground_speed_m_s(self) -> float:
        """Speed over the ground."""
        return math.hypot(*self.velocity_ned_m_s[:2])


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalAttitude:
    """How a gimbal is turned at one instant of vehicle time. Its axes: ahead, right, below.

    rotation:        (3, 3) float64 from these axes to north, east, down
    is_from_heading: whether the vehicle's heading stands for north there
    """

    time_s: float
    rotation: FloatArray
    is_from_heading: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class GpsFix:
    """How well satellites place the vehicle.

    num_satellites: seen; dilution: of the horizontal position; None where it is not known
    """

    is_3d: bool
    num_satellites: int | None
    dilution: float | None

    def __str__(self) -> str:
        satellites = "?" if self.num_satellites is None else self.num_satellites
        dilution = "?" if self.dilution is None else f"{self.dilution:.1f}"
        fix = "3D fix" if self.is_3d else "no 3D fix"
        return f"{fix}, {satellites} satellites, dilution {dilution}"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """A pinhole camera without distortion.

    It looks straight down from a level vehicle or gimbal, the picture's top towards its nose.
    """

    width_px: int
    height_px: int
    horizontal_fov_rad: float

    @property
    def focal_px(self) -> float:
        """Focal length; pixels are square."""
        return self.width_px / 2.0 / math.tan(self.horizontal_fov_rad / 2.0)

    @property
    def vertical_fov_rad(self) -> float:
        """Angle of view from the top to the bottom edge."""
        return 2.0 * math.atan(self.height_px / 2.0 / self.focal_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """One camera picture. image: (height, width, 3) uint8 BGR; time_s: vehicle time at capture."""

    time_s: float
    image: ImageArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """One target found in one picture.

    `pixel_px` is (u, v) of its centre on the ground, u right and v down from the top left.
    """

    appearance: str
    pixel_px: tuple[float, float]
    score: float
    """Confidence in the class, 0 to 1."""
    box_px: tuple[float, float, float, float] | None = None
    """Left, top, right and bottom of what was found, where the detector tells."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Obstacle:
    """What stands on the ground and hides what is behind it: upright, and flat on top.

    corners_au: (K, 2) float64 au in order, not closed
    height_m:   above the ground
    """

    corners_au: FloatArray
    height_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """What the binary sensor said about every target at one instant.

    time_au: mission time; agent_au: (2,) agent's position; seen: (N,) bool; target_au: (N, 2)
    position of each target seen, NaN
    where it was not; view_au: radius about the agent in which a target that is not seen is not: the
    sensor's, or less where a tilt takes ground out of the picture, or something hides it.
    hidden_au: (S, 2) the same by direction where things stand: from where to where, away from the
    agent, ground may be out of view, in each of S even sectors, counterclockwise from that after
    the x axis; both are the sensor's radius where all is in view; None where nothing stands.
    `dronemon.sightings.is_in_view` reads both.
    Source: paper, equation 1.
    """

    time_au: float
    agent_au: FloatArray
    seen: BoolArray
    target_au: FloatArray
    view_au: float = SENSOR_RADIUS_AU
    hidden_au: FloatArray | None = None
