"""What a mission needs of a vehicle: its state, its clock, and commands that telemetry confirms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, Protocol

from dronemon.frames import GeoPoint
from dronemon.types import GimbalAttitude, GpsFix, Pose, Vector3
from dronemon.vehicle.fence_items import FenceItem


class Mode(StrEnum):
    """PX4's flight modes, by the names that its users know."""

    MANUAL = "manual"
    ALTITUDE = "altitude"
    ALTITUDE_CRUISE = "altitude cruise"
    POSITION = "position"
    POSITION_SLOW = "position slow"
    ORBIT = "orbit"
    ACRO = "acro"
    STABILIZED = "stabilized"
    RATTITUDE = "rattitude"
    OFFBOARD = "offboard"
    TERMINATION = "termination"
    READY = "ready"
    TAKEOFF = "take-off"
    VTOL_TAKEOFF = "VTOL take-off"
    HOLD = "hold"
    MISSION = "mission"
    RETURN = "return"
    LAND = "land"
    FOLLOW = "follow"
    PRECISION_LAND = "precision land"
    OTHER = "other"


BY_STICKS = (
    *(Mode.MANUAL, Mode.ALTITUDE, Mode.ALTITUDE_CRUISE, Mode.POSITION, Mode.POSITION_SLOW),
    *(Mode.ACRO, Mode.STABILIZED, Mode.RATTITUDE),
)
"""Modes in which a pilot flies."""


UNFLOWN = frozenset({Mode.TAKEOFF, Mode.HOLD, Mode.RETURN, Mode.LAND})
"""Modes in which a vehicle may be in the air and nobody flies it."""


class Landed(StrEnum):
    """What the autopilot's landing detector says."""

    UNKNOWN = "unknown"
    ON_GROUND = "on ground"
    IN_AIR = "in air"
    TAKING_OFF = "taking off"
    LANDING = "landing"


AIRBORNE = frozenset({Landed.IN_AIR, Landed.TAKING_OFF, Landed.LANDING})


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleState:
    """Everything slow that telemetry says; the pose comes apart, it is fast.

    What has not been heard for 10 s of vehicle time counts as unknown, or as bad.
    """

    mode: Mode = Mode.OTHER
    is_armed: bool = False
    is_failsafe: bool = False
    is_doubted: bool = False
    """Whether the newest heartbeat says otherwise, and is believed only with the next ones."""
    are_two: bool = False
    """Whether another vehicle of the same system id is heard: all that is known may be its own."""
    fell_from: Pose | None = None
    """The pose when the motors ran for the last time, in the air, if it has fallen since."""
    is_armable: bool = False
    """Whether the arming checks pass."""
    is_position_good: bool = False
    """Whether the estimator has an absolute horizontal position; without GPS it drifts."""
    landed: Landed = Landed.UNKNOWN
    battery: float | None = None
    """Charge left, 0 to 1; None where the vehicle does not know."""
    is_estimate_heard: bool = False
    """Whether the estimator says how it is. Where it has fallen silent, a position that was good
    counts as good as long as GPS has a fix and the place is told."""
    estimate_doubts: tuple[str, ...] = ("no word of it",)
    """What is against the estimate, in words."""
    accuracy_m: float | None = None
    """Standard deviation of the horizontal position along one axis, as the estimator has it."""
    height_accuracy_m: float | None = None
    """That of the height."""
    gps: GpsFix | None = None
    remote_id: str | None = None
    """What its remote ID has against arming, nothing if it is ready; None if none is heard."""
    range_limits_m: tuple[float, float] | None = None
    """Least and greatest range that its rangefinder tells downwards; None if none is heard."""
    has_sticks: bool = False
    """Whether a remote control is heard."""
    hardware: str | None = None
    """What the autopilot's board is called, unlike every other one."""
    home: GeoPoint | None = None
    origin: GeoPoint | None = None
    """Origin of the local NED frame."""
    place: GeoPoint | None = None
    """Where the vehicle is on the globe."""
    num_resets: int = 0
    """How often the position jumped as no velocity explains: the estimator was reset."""
    jumped_down_m: float = 0.0
    """How far down it jumped then, all jumps together."""
    num_unreadable: int = 0
    """Messages left out, since they hold what cannot be, such as a number that is none."""

    def describe(self) -> str:
        """The state in words."""
        armed = "armed" if self.is_armed else "disarmed"
        checks = "" if self.is_armable else ", arming checks not passed"
        return f"mode '{self.mode}', {armed}, {self.landed}{checks}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Setpoint:
    """Where to be, how to move and where to look, at once."""

    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    acceleration_ned_m_s2: Vector3 = (0.0, 0.0, 0.0)
    yaw_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusText:
    """What the autopilot said in words. A part that was lost on the way is marked "…"."""

    severity: int
    """MAVLink's: from 0, emergency, to 7, debug; 4 is a warning."""
    text: str

    @property
    def level(self) -> Literal["INFO", "WARN", "ERROR"]:
        """How loud it is to be told."""
        return "ERROR" if self.severity <= 3 else "WARN" if self.severity == 4 else "INFO"


class VehicleLink(Protocol):
    """A vehicle under our command; an async context manager that is connected while it is open.

    Every command returns once telemetry confirms it. All raise LinkLost (silence), ControlTaken (a
    mode that we did not ask for), CommandRejected or CommandUnconfirmed.
    """

    @property
    def system_id(self) -> int:
        """By which the vehicle is heard."""

    @property
    def state(self) -> VehicleState:
        """The newest state."""

    @property
    def pose(self) -> Pose:
        """The newest pose. Raises LinkTimeout before the first."""

    @property
    def time_s(self) -> float:
        """Vehicle time since boot of the newest pose: a link is a Clock."""

    async def next_pose(self) -> Pose:
        """Wait for a pose newer than the last one given; a slow reader misses poses, never lags."""

    async def poses_around(self, time_s: float) -> tuple[Pose, Pose]:
        """Wait for the poses just before and just after an instant of the recent past or future."""

    async def gimbal_around(self, time_s: float) -> tuple[GimbalAttitude, GimbalAttitude]:
        """Wait for the gimbal's attitudes just before and just after an instant.

        Raises CameraError where they are not heard.
        """

    async def range_at(self, time_s: float) -> float:
        """Wait for what the rangefinder tells of an instant: m down from the vehicle's body.

        Raises CameraError where it is not heard, or finds no ground.
        """

    async def wait_until(self, condition: Callable[[], bool], what: str, timeout_s: float) -> None:
        """Wait in vehicle time until telemetry makes `condition` true; `what` says it in errors."""

    async def wait_ready(self, timeout_s: float) -> None:
        """Wait until the vehicle knows where it is and passes its arming checks."""

    async def read_parameters(self, names: Iterable[str]) -> Mapping[str, float]:
        """Values by name of those that the vehicle has; NaN where one cannot be read."""

    async def write_parameter(self, name: str, value: float) -> None:
        """Set a parameter, and read it back. Raises OptionError for what it cannot be."""

    async def read_fence(self) -> tuple[FenceItem, ...]:
        """The fence that the vehicle has, empty if it has none."""

    async def write_fence(self, items: Sequence[FenceItem]) -> None:
        """Replace the vehicle's fence, and read it back."""

    async def point_down(self) -> None:
        """Take control of the gimbal and have it look straight down, with the vehicle's heading.

        Raises ControlTaken where somebody arms or flies the vehicle meanwhile.
        """

    async def arm(self) -> None:
        """Start the motors."""

    async def disarm(self) -> None:
        """Stop the motors; only on the ground."""

    async def take_off(self, height_m: float) -> None:
        """Climb to a height above the present place and hold there."""

    async def start_offboard(self, setpoint: Setpoint) -> None:
        """Hand the vehicle over to our setpoints, beginning with this one."""

    async def send_setpoint(self, setpoint: Setpoint) -> None:
        """Send one setpoint; the vehicle's own failsafe ends offboard control when they stop."""

    async def hold(self) -> None:
        """Stop and stay."""

    async def return_home(self) -> None:
        """Begin to fly home and land there, by the autopilot alone."""

    async def land(self) -> None:
        """Begin to land here, by the autopilot alone."""

    async def next_texts(self) -> list[StatusText]:
        """Wait, without a limit, until the autopilot says something. -> all since the last call"""

    @property
    def heartbeat_age_s(self) -> float:
        """Wall time since the last heartbeat: the age of mode and armed state."""

    @property
    def num_heartbeats(self) -> int:
        """How many heartbeats of the autopilot were heard."""

    async def next_heartbeat(self) -> None:
        """Wait for the next heartbeat: what it says of mode and arming is fresh."""

    def release(self) -> None:
        """From now on any mode is welcome: whoever chose it is in control."""

    def reclaim(self) -> None:
        """From now on offboard alone is welcome: the pilot chose it, to give control back."""
