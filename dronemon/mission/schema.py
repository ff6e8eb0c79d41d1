"""What a mission file may say: frozen models with units in their keys, defaults and bounds.

One mission is one flight. `sim` reads the same file for the simulated world, so that one YAML is
one flight and, for the mock, one world.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr, field_validator, model_validator

from dronemon.mission.addresses import mavlink_url_problem
from dronemon.mission.area import Area
from dronemon.mission.camera import Camera, PlaceErrors
from dronemon.mission.detector import DetectorSection
from dronemon.mission.faults import parse_fault
from dronemon.mission.section import Fraction, Section
from dronemon.problem import (
    DEFAULT_HISTORY,
    LENGTH_SCALE_AU,
    MAX_HISTORY,
    MAX_TARGETS,
    MEASUREMENT_INTERVAL_AU,
    SENSOR_RADIUS_AU,
    TIME_SCALE_AU,
    motion_name_flaw,
)
from dronemon.sensor import LIMITS
from dronemon.sensor import Sensor as SensorModel
from dronemon.types import APPEARANCES, GRAVITY_M_S2

_Coordinate = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Place = Annotated[tuple[_Coordinate, _Coordinate], Field(strict=False)]
"""In au; `field.place_problems` sees that it is in the area."""
_TURN_S = 4.0
_BLOWN_OFF_M, _BLOWN_OFF_S = 1.0, 0.3
"""How far off its path a drone is in wind, at rest and for each metre per second."""
FOLLOWING_M_S = 1.2
"""Up or down, at most, over ground that is followed: PX4 sinks at 1.5 m/s at most as it comes, and
what is left of that is for staying there."""
GIMBAL_ERROR_DEG = 5.0
"""How far a gimbal that was told to look down may look off."""


class Flight(Section):
    """How the drone flies."""

    altitude_m: float = Field(45.0, ge=2.0, le=500.0)
    """Height above the take-off point on patrol; above the ground below with follow_terrain."""
    follow_terrain: bool = False
    """Whether to fly over hills and valleys of area.terrain, rather than at one height."""
    stand_off_m: float = Field(10.0, ge=2.0, le=500.0)
    """How far below the patrol the highest ground and zones that it flies over have to be."""
    ceiling_m: float | None = Field(None, ge=2.0, le=1000.0)
    """How far above the ground the patrol may be, as rules or a permit say; any if absent."""
    cruise_speed_m_s: float = Field(5.0, ge=0.5, le=25.0)
    """Ground speed on patrol."""
    max_speed_m_s: float | None = Field(None, ge=0.5, le=50.0)
    """Bound of the ground speed that guidance asks for; cruise and 10 % if absent."""
    max_acceleration_m_s2: float = Field(2.0, ge=0.5, le=10.0)
    """Acceleration asked for in a turn of 60 degrees; at least cruise speed by 4 s."""
    horizon_au: float | None = Field(None, gt=0.0, le=1000.0)
    """Patrol length in sides of the area; 30 if horizon_min is absent too."""
    horizon_min: float | None = Field(None, gt=0.0, le=600.0)
    """Patrol length in minutes of cruise, instead of horizon_au."""
    reserve_battery: Fraction = 0.15
    """Battery level (0 to 1) to land with; the drone returns in time for that."""
    endurance_min: float = Field(30.0, gt=0.0, le=600.0)
    """Flight time of a full battery; the check before take-off uses it."""
    start_au: Place | None = None
    """Where the patrol starts, [x, y] from 0 to 1, or in au of a field; drawn if absent."""
    fence_margin_m: float = Field(30.0, ge=10.0, le=1000.0)
    """How far the fence is from the area, home and the way between."""
    relay: Literal["confirmed", "automatic"] | None = None
    """Fly on with a fresh battery once `dronemon resume RUN` says so, or by itself; else end."""

    @model_validator(mode="after")
    def _one_horizon(self) -> Flight:
        if self.horizon_au is not None and self.horizon_min is not None:
            raise ValueError("give horizon_au or horizon_min, not both")
        return self

    @property
    def speed_limit_m_s(self) -> float:
        """Bound of the ground speed that guidance asks for."""
        return self.max_speed_m_s or 1.1 * self.cruise_speed_m_s

    @property
    def turn_acceleration_m_s2(self) -> float:
        """What guidance asks for in turns: a fast drone would else leave its legs by too much."""
        return max(self.max_acceleration_m_s2, self.cruise_speed_m_s / _TURN_S)

    @property
    def turn_window_m(self) -> float:
        """How long before and after a corner the drone turns, see `dronemon.guidance`."""
        return 0.5 * self.cruise_speed_m_s**2 / self.turn_acceleration_m_s2

    @property
    def clearance_m(self) -> float:
        """How far from its legs the drone may come: it cuts corners, and is blown off a little."""
        return 0.5 * self.turn_window_m + _BLOWN_OFF_M + _BLOWN_OFF_S * self.cruise_speed_m_s

    @property
    def steepest(self) -> float:
        """Metres up or down for each metre over ground that is followed."""
        return FOLLOWING_M_S / self.cruise_speed_m_s

    @property
    def bank_rad(self) -> float:
        """How far the drone banks for that."""
        return math.atan(self.turn_acceleration_m_s2 / GRAVITY_M_S2)

    @property
    def what_banks(self) -> str:
        """The key that lowers the bank."""
        is_fast = self.turn_acceleration_m_s2 > self.max_acceleration_m_s2
        return "cruise_speed_m_s" if is_fast else "max_acceleration_m_s2"


class Vehicle(Section):
    """The vehicle and the limits on waiting for it."""

    url: str = "mock"
    """`mock`, or a MAVLink URL: udpin://IP:PORT, tcpout://IP:PORT, serial://DEVICE:BAUD."""
    system_id: int | None = Field(None, ge=1, le=255)
    """MAVLink system id of the vehicle; needed where several are heard."""
    speed_up: float = Field(15.0, ge=1.0, le=20.0)
    """How much faster than real time the mock flies."""
    connect_timeout_s: float = Field(10.0, gt=0.0, le=300.0)
    """Wall-clock wait for the first heartbeat."""
    ready_timeout_s: float = Field(60.0, gt=0.0, le=600.0)
    """Wall-clock wait for sensors, position and arming checks."""
    command_timeout_s: float = Field(10.0, ge=3.0, le=120.0)
    """Wait until telemetry confirms a command."""
    link_loss_timeout_s: float = Field(5.0, ge=1.0, le=60.0)
    """Silence after which the link counts as lost."""

    @field_validator("url")
    @classmethod
    def _known_url(cls, url: str) -> str:
        if url != "mock" and (problem := mavlink_url_problem(url)):
            raise ValueError(f"{problem}; or `mock` for the built-in vehicle")
        return url

    @property
    def is_mock(self) -> bool:
        """Whether the built-in kinematic autopilot flies."""
        return self.url == "mock"


class Sensor(Section):
    """How the eye is expected to err; a simulated one does by its faults hide, decoy and so on."""

    miss: float = Field(0.0, ge=0.0, le=LIMITS["miss"])
    """Chance that a target in view is not found."""
    false_alarms: float = Field(0.0, ge=0.0, le=LIMITS["false_alarms"])
    """Targets found in a picture where there are none, in the mean."""
    position_au: float = Field(0.0, ge=0.0, le=LIMITS["position_au"])
    """Error of the place of a target found, one sigma per axis, over the area's side."""
    confusion: float = Field(0.0, ge=0.0, le=LIMITS["confusion"])
    """Chance that a target found is taken for another."""

    @property
    def model(self) -> SensorModel:
        """What beliefs and planners take."""
        return SensorModel(**self.model_dump())


class KeepOff(Section):
    """How near the drone may come on patrol."""

    distance_m: float = Field(ge=1.0, le=500.0)
    """Least distance over ground from where the target is believed to be."""
    below_m: float = Field(ge=2.0, le=500.0)
    """Height of the patrol, as flight.altitude_m counts it, from which on it is not kept off."""


class Target(Section):
    """One target to watch."""

    name: str = Field(min_length=1, max_length=40)
    """What records and tables call it."""
    appearance: str = Field(
        min_length=1,
        max_length=80,
        description="What the detector knows it by: "
        f"{', '.join(APPEARANCES)} of the simulator, else a class of the network, the "
        "number of a marker, or any word for a blob. Several may have the same.",
    )
    count: int = Field(1, ge=1, le=MAX_TARGETS)
    """How many there are of it, called NAME 1, NAME 2 and so on."""
    prior_au: Place | Literal["simulated"] | None = Field(
        None,
        description="Position known before take-off: [x, y] from 0 to 1, or `simulated`, which "
        "takes it from the simulated world; x runs east and y north from the area's south-west "
        "corner, of a field in au, its box about [0.5, 0.5]; unknown if absent.",
    )
    keep_off: KeepOff | None = None
    """{distance_m: 10, below_m: 60} leaves it in peace; without, the drone flies over it."""
    _entry: int = PrivateAttr(0)

    @property
    def entry(self) -> int:
        """Which of the file's entries it comes from, from 0."""
        return self._entry

    @model_validator(mode="after")
    def _are_apart(self) -> Target:
        if self.count > 1 and isinstance(self.prior_au, tuple):
            raise ValueError(f"{self.count} of them cannot all be at {list(self.prior_au)}")
        return self

    def each(self, entry: int) -> Iterator[Target]:
        """Every single one of an entry of the file."""
        for number in range(1, self.count + 1):
            name = self.name if self.count == 1 else f"{self.name} {number}"
            one = self.model_copy(update={"name": name, "count": 1})
            one._entry = entry
            yield one


class Belief(Section):
    """Kernel of the Gaussian processes. Source: paper, section III-C.

    The search planners look ahead with the default kernel, whatever stands here.
    """

    length_scale_au: float = Field(LENGTH_SCALE_AU, gt=0.0, le=1.0)
    """Spatial length scale."""
    time_scale_au: float = Field(TIME_SCALE_AU, gt=0.0, le=100.0)
    """Temporal length scale."""


class Roadmap(Section):
    """The random roadmap."""

    num_nodes: int = Field(200, ge=10, le=2000)
    """Places that it joins."""
    num_neighbours: int = Field(10, ge=2, le=50)
    """Nearest neighbours each node is joined to, itself included."""


class Planner(Section):
    """What chooses the waypoints."""

    kind: str = "search"
    """Name of a planner, which `dronemon planners` lists, or package.module:Class."""
    checkpoint: str | None = Field(
        None,
        description="Trained weights of a learned planner: a path from this file, or the name of "
        "shipped ones, which are taken if absent.",
    )
    history: int | None = Field(
        None,
        ge=1,
        le=MAX_HISTORY,
        description=f"How many decisions a learned planner looks back; {DEFAULT_HISTORY} if "
        "absent.",
    )


class Simulation(Section):
    """The simulated world; a real vehicle over real animals ignores it."""

    seed: int = Field(0, ge=0)
    """Root of all that is drawn: world, start, roadmap, planner."""
    speed_ratio: float = Field(0.05, ge=0.0, lt=1.0)
    """Targets' speed over the drone's."""
    speed_spread: float = Field(0.0, ge=0.0, le=0.9)
    """Share by which targets may be faster or slower than that."""
    motion: str = "tsp"
    """tsp (the paper's), waypoints, correlated, brownian, grazing, loop, herd, road, or a file."""
    wind_m_s: float = Field(0.0, ge=0.0, le=15.0)
    """Mean wind speed."""
    wind_from_deg: float = Field(270.0, ge=0.0, le=360.0)
    """Where it comes from, clockwise from north."""
    position_noise_m: float = Field(0.15, ge=0.0, le=5.0)
    """Error of the estimated position, one sigma per axis."""
    exposure_s: float = Field(0.0, ge=0.0, le=0.1)
    """How long the camera's shutter is open, while the drone's motion blurs the picture."""
    light: float = Field(1.0, ge=0.01, le=1.0)
    """Share of full daylight; down to 1/16 the camera amplifies it, and its noise."""
    shadow: float = Field(0.0, ge=0.0, le=0.9)
    """How much darker it is under clouds, which shade half of the ground."""
    jpeg_quality: int = Field(95, ge=5, le=100)
    """Of the camera's pictures; below 90 colours have half the resolution."""
    faults: Annotated[tuple[str, ...], Field(strict=False)] = Field((), max_length=100)
    """Things to go wrong: KIND[=VALUE][@SECONDS after arming][+DURATION]."""

    @field_validator("motion")
    @classmethod
    def _is_motion(cls, name: str) -> str:
        if flaw := motion_name_flaw(name):
            raise ValueError(flaw)
        return name

    @field_validator("faults")
    @classmethod
    def _are_faults(cls, texts: tuple[str, ...]) -> tuple[str, ...]:
        for text in texts:
            parse_fault(text)
        return texts


class View(Section):
    """The live view."""

    live: bool = False
    """Serve the Rerun viewer while flying."""
    port: int = Field(9876, ge=1024, le=65535)
    """Port of the viewer's data on 127.0.0.1."""


class Record(Section):
    """The run folder."""

    pictures: bool = True
    """Keep the pictures in flight.rrd."""


class Mission(Section):
    """One flight."""

    name: str = Field("mission", min_length=1, max_length=80)
    """What records and tables call it."""
    area: Area = Area()
    flight: Flight = Flight()
    vehicle: Vehicle = Vehicle()
    camera: Camera = Camera()
    detector: DetectorSection = DetectorSection()
    sensor: Sensor = Sensor()
    errors: PlaceErrors = PlaceErrors()
    targets: tuple[Target, ...] = Field(strict=False, min_length=1, max_length=MAX_TARGETS)
    """The targets to watch, each with its own name."""
    belief: Belief = Belief()
    roadmap: Roadmap = Roadmap()
    planner: Planner = Planner()
    simulation: Simulation = Simulation()
    view: View = View()
    record: Record = Record()

    @field_validator("targets")
    @classmethod
    def _one_by_one(cls, entries: tuple[Target, ...]) -> tuple[Target, ...]:
        targets = [one for entry, target in enumerate(entries) for one in target.each(entry)]
        if len(targets) > MAX_TARGETS:
            raise ValueError(f"are {len(targets)}; {MAX_TARGETS} can be watched at most")
        return tuple(targets)

    @property
    def horizon_au(self) -> float:
        """Patrol length."""
        if self.flight.horizon_min is not None:
            return self.flight.horizon_min * 60.0 * self.flight.cruise_speed_m_s / self.area.side_m
        return self.flight.horizon_au if self.flight.horizon_au is not None else 30.0

    @property
    def kept_off_m(self) -> dict[int, float]:
        """Number -> distance of each target that the drone keeps off at the patrol's height."""
        asked = {n: t.keep_off for n, t in enumerate(self.targets) if t.keep_off is not None}
        height_m = self.flight.altitude_m
        return {n: off.distance_m for n, off in asked.items() if height_m < off.below_m}

    @property
    def seconds_per_au(self) -> float:
        """Time in which one side is flown."""
        return self.area.side_m / self.flight.cruise_speed_m_s

    @property
    def num_pictures(self) -> int:
        """Pictures of a whole patrol."""
        return math.floor(self.horizon_au / MEASUREMENT_INTERVAL_AU + 1e-6)

    @property
    def patrol_duration_s(self) -> float:
        """Duration of the patrol at cruise speed."""
        return self.horizon_au * self.seconds_per_au

    @property
    def sensor_radius_m(self) -> float:
        """Radius of the circular footprint on the ground."""
        return SENSOR_RADIUS_AU * self.area.side_m
