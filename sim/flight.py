"""The mock flight: one clock that moves vehicle, world, links and faults together."""

from __future__ import annotations

import asyncio
import logging
import math
import random
import time
from dataclasses import replace
from functools import partial

import numpy as np

from dronemon.frames import AreaFrame, GeoPoint, ned_to_geo
from dronemon.mission import Mission
from dronemon.mission.faults import Fault
from dronemon.types import Vector3
from dronemon.world.instance import named_stream
from sim.autopilot import STEP_S, Autopilot
from sim.dynamics import Wind
from sim.faults import FaultSchedule, mission_faults, parse_vehicle_fault
from sim.gimbal import Gimbal
from sim.link import MavlinkLink
from sim.modes import Px4Mode
from sim.scene import Scene
from sim.world import World, home_place

_LOG = logging.getLogger("sim")
HOME_NED_M: Vector3 = (-23.0, 31.0, -3.2)
"""Home in the local frame: the estimator's origin is elsewhere, so that confusing them shows."""
_PROBLEM = "Preflight Fail: Compass Sensor 0 missing"
_BREACH = "Geofence: approaching or outside geofence"
_PAUSE_S = 0.004
_LOOK_DOWN_S = 0.2
"""Vehicle time between looks for the height of the ground."""
_BURST_MAX_S = 0.2
"""Vehicle time simulated at once; a computer that stalls longer slows the simulation down."""


def _stream(mission: Mission, name: str) -> random.Random:
    """A fast generator of its own for one purpose."""
    return random.Random(int(named_stream(mission.simulation.seed, name).integers(2**63)))


class MockFlight:
    """A mission's mock vehicle in its world.

    faults: all there are, the mission's included
    clock_s: vehicle time at which it begins
    """

    def __init__(
        self,
        mission: Mission,
        world: World,
        faults: tuple[Fault, ...] = (),
        clock_s: float = 0.0,
    ) -> None:
        simulation = mission.simulation
        away_m = -np.asarray(HOME_NED_M, dtype=np.float64)
        origin: GeoPoint = ned_to_geo(away_m, home_place(mission))
        wind_rng = _stream(mission, "wind")
        wind_from_rad = math.radians(simulation.wind_from_deg)
        self.autopilot = Autopilot(
            origin=origin,
            start_ned_m=HOME_NED_M,
            make_wind=lambda: Wind(simulation.wind_m_s, wind_from_rad, wind_rng),
            endurance_s=mission.flight.endurance_min * 60.0,
            noise_m=simulation.position_noise_m,
            rng=_stream(mission, "estimate"),
        )
        self.autopilot.set_clock(clock_s)
        self.autopilot.gimbal = Gimbal() if mission.camera.gimbal else None
        self.autopilot.has_rangefinder = mission.area.rangefinder
        self._world = world
        self._frame: AreaFrame = world.frame(HOME_NED_M, origin)
        self._links: list[MavlinkLink] = []
        self._line_rng = _stream(mission, "line")
        self._time_s = self._flown_s = self._looked_s = 0.0
        self._is_hilly = mission.area.terrain is not None
        listed = mission_faults(mission, parse_vehicle_fault)
        self.faults = FaultSchedule((*listed, *faults), self._switch)

    def _switch(self, kind: str, value: float | None) -> None:
        """Begin a fault, or end it where the value is None."""
        autopilot, is_on = self.autopilot, value is not None
        if kind.isupper() and value is not None:
            autopilot.parameters.set(kind, value)
        elif kind == "pilot" and is_on:
            autopilot.commander.take_over()
        elif kind == "pilot":
            autopilot.request_mode(Px4Mode.OFFBOARD)
        elif kind == "battery" and value is not None:
            autopilot.battery_level = value
        elif kind == "jump":
            autopilot.jump(value or 0.0)
        elif kind == "reboot":
            autopilot.reboot()
        autopilot.has_gps = "gps" not in self.faults.active
        autopilot.ignores_setpoints = "ignore" in self.faults.active
        autopilot.problems = (_PROBLEM,) if "unarmable" in self.faults.active else ()
        autopilot.breach = _BREACH if "fence" in self.faults.active else None
        autopilot.is_range_lost = "range" in self.faults.active
        if autopilot.gimbal is not None:
            autopilot.gimbal.is_silent = "gimbal" in self.faults.active
            autopilot.gimbal.askew_rad = math.radians(self.faults.active.get("askew", 0.0))

    def scene(self) -> Scene:
        """What there is to see at this instant."""
        body, gimbal = self.autopilot.body, self.autopilot.gimbal
        pose = body.pose(self.autopilot.time_s)
        turn_rad_s = body.roll_rate, body.pitch_rate, body.yaw_rate
        if gimbal is not None:  # it turns with the heading alone
            camera_rad = gimbal.camera_attitude_rad(pose.attitude_rad[2])
            pose, turn_rad_s = replace(pose, attitude_rad=camera_rad), (0.0, 0.0, body.yaw_rate)
        return self._world.scene(pose, self._frame, self._time_s, turn_rad_s)

    async def open_links(
        self, remotes: list[tuple[str, int]], signing_key: bytes | None = None
    ) -> None:
        """Stream to these addresses from now on, signed if there is a key."""
        loop = asyncio.get_running_loop()
        for remote in remotes:
            faults, rng = self.faults.active, self._line_rng
            link = partial(MavlinkLink, self.autopilot, remote, faults, rng, signing_key)
            endpoint = await loop.create_datagram_endpoint(link, local_addr=("127.0.0.1", 0))
            self._links.append(endpoint[1])

    def close_links(self) -> None:
        """Close all sockets."""
        for link in self._links:
            link.close()

    def step(self) -> None:
        """One step of everything."""
        self._time_s += STEP_S
        autopilot = self.autopilot
        self._raise_ground()
        autopilot.step()
        self.faults.advance(self._time_s, autopilot.commander.is_armed)
        self._swap_battery()
        texts = list(autopilot.texts)
        autopilot.texts.clear()
        for link in self._links:
            link.stream(texts)

    def _raise_ground(self) -> None:
        """Have the ground of a terrain below the vehicle, wherever it flies."""
        if self._is_hilly and self._time_s >= self._looked_s + _LOOK_DOWN_S:
            self._looked_s, body = self._time_s, self.autopilot.body
            here_m = np.array(body.position[:2])
            body.ground_down_m = float(self._world.ground_down_m(here_m, self._frame))

    def _swap_battery(self) -> None:
        """Have a fresh battery in place of one that has flown, if that is asked for."""
        if self.autopilot.commander.is_armed or not self.autopilot.is_landed:
            self._flown_s = self._time_s
        elif self._time_s >= self._flown_s + self.faults.active.get("swap", math.inf):
            self.autopilot.battery_level = 1.0

    def flush(self) -> None:
        """Hand everything sent so far to the network."""
        for link in self._links:
            link.flush()

    async def run(self, speed_up: float) -> None:
        """Keep vehicle time at wall time x `speed_up`, until cancelled.

        While a setpoint is late it runs in real time: a pause of the other program that is nothing
        to a vehicle would else count `speed_up` times.
        """
        begin_s, started_at_s = time.monotonic(), self._time_s
        try:
            await self._keep_pace(speed_up)
        finally:
            flown_s, wall_s = self._time_s - started_at_s, time.monotonic() - begin_s
            ratio = flown_s / max(wall_s, 1e-9)
            _LOG.info("simulated %.0f s, %.1f times real time (%g asked)", flown_s, ratio, speed_up)
            armed = "armed" if self.autopilot.commander.is_armed else "disarmed"
            _LOG.info("the vehicle is %s", armed)

    async def _keep_pace(self, speed_up: float) -> None:
        due_s, last_s = self._time_s, time.monotonic()
        while True:
            now_s = time.monotonic()
            pace = 1.0 if self.autopilot.is_setpoint_late else speed_up
            due_s += min((now_s - last_s) * pace, _BURST_MAX_S)
            last_s = now_s
            while self._time_s + STEP_S <= due_s:
                self.step()
            self.flush()
            await asyncio.sleep(_PAUSE_S)
