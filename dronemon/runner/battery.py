"""What is left in the battery, and what it takes to come home from here: today, in this wind."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence

from dronemon.energy import Cost, Drain, cost_home, lean_rate
from dronemon.errors import VehicleError
from dronemon.frames import GeoPoint, geo_to_ned
from dronemon.guidance import Drag, Point
from dronemon.mission.schema import Flight
from dronemon.types import Vector3
from dronemon.vehicle import Landed, VehicleLink


class Battery:
    """Follows the vehicle's level and its way home.

    level:      0 to 1, as heard, or else as it is used up since; None if it was never heard
    flown_to:   the level when it last was in the air; None if it was not, or it was never heard
    needed:     the level that it takes to come home from here and land
    drag:       how the air brakes the vehicle; whoever guides it lets it learn
    parameters: the vehicle's energy.RETURN_PARAMETERS
    legs_home:  the way home from a place, each leg (north, east) in m, where it is not straight
    end_m:      height above home at which that ends, where it follows the ground
    """

    def __init__(self, link: VehicleLink, flight: Flight) -> None:
        self._link = link
        self._endurance_s = 60.0 * flight.endurance_min
        self._reserve = flight.reserve_battery
        self.level: float | None
        self.flown_to: float | None = None
        self.needed = 0.0
        self.drag = Drag()
        self.parameters: Mapping[str, float] = {}
        self.legs_home: Callable[[Point], Sequence[Point]] | None = None
        self.end_m: float | None = None
        self._time_s = math.inf
        self._home: tuple[GeoPoint | None, GeoPoint | None] = None, None
        self._home_ned_m: Vector3 = (0.0, 0.0, 0.0)
        self._start(None)

    def _start(self, level: float | None) -> None:
        """On the ground: a flight begins, maybe with another battery."""
        self._flown = Cost(0.0, 0.0)
        self._drain = Drain(self._endurance_s)
        self.level = level

    def go_on(self, airborne_s: float) -> None:
        """It has been in the air for so long before it was followed."""
        self._fly(airborne_s, 1.0)

    def take(self) -> None:
        """Follow the newest state and pose, if there is one."""
        state = self._link.state
        with contextlib.suppress(VehicleError):  # not heard yet
            pose = self._link.pose
            passed_s = max(pose.time_s - self._time_s, 0.0)
            self._time_s = pose.time_s
            if state.landed is Landed.ON_GROUND and not state.is_armed:
                self._start(state.battery)
            else:
                roll_rad, pitch_rad, _ = pose.attitude_rad
                self._fly(passed_s, lean_rate(roll_rad, pitch_rad))
                self._use(passed_s, state.battery)
                if state.landed is not Landed.ON_GROUND:  # there a battery recovers
                    self.flown_to = self.level
            self._follow_home(state.home, state.origin)
            (north, east, down), (home_north, home_east, home_down) = (
                pose.position_ned_m,
                self._home_ned_m,
            )
            if self.legs_home is not None:
                legs_m = self.legs_home((north, east))
            else:
                legs_m = [(home_north - north, home_east - east)]
            height_m = home_down - down if self.end_m is None else self.end_m
            cost = cost_home(legs_m, height_m, self.parameters, self.drag.wind)
            self.needed = self._drain.needed(cost)

    def _fly(self, passed_s: float, effort_rate: float) -> None:
        time_s, effort_s = self._flown
        self._flown = Cost(time_s + passed_s, effort_s + passed_s * effort_rate)

    def _use(self, passed_s: float, level: float | None) -> None:
        if level is not None:
            self._drain.take(self._flown, level)
            self.level = level
        elif self.level is not None:
            self.level = max(self.level - passed_s * self._drain.per_s, 0.0)

    def _follow_home(self, home: GeoPoint | None, origin: GeoPoint | None) -> None:
        if home is None or origin is None or (home, origin) == self._home:
            return
        self._home = home, origin
        north, east, down = map(float, geo_to_ned(home, origin))
        self._home_ned_m = north, east, down

    @property
    def is_low(self) -> bool:
        """Whether the level known just brings it home with what is to be left."""
        return self.level is not None and self.level <= self.needed + self._reserve

    @property
    def is_time_up(self) -> bool:
        """The same of a battery that lasts as long as the mission says."""
        return 1.0 - self._flown.time_s / self._endurance_s <= self.needed + self._reserve

    def __str__(self) -> str:
        left = "level unknown" if self.level is None else f"{self.level:.0%} left"
        return f"{left}, {self.needed:.0%} needed to get home, {self._reserve:.0%} to land with"
