"""Any MAVLink vehicle's pose as a world's clock and camera: a real PX4 SITL over the same animals.

It listens as a ground station on an endpoint of its own. A picture is taken at the newest instant
of which the pose is known; what is older is carried on to it with its rate of change.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable
from typing import Any, Self

from pymavlink.dialects.v20 import common as mavlink

from dronemon.frames import GeoPoint
from dronemon.mission.faults import Fault
from dronemon.types import Pose, Vector3
from sim.camera import CameraServer
from sim.faults import FaultSchedule
from sim.scene import Scene
from sim.world import World

_SYSTEM_ID = 254
_HEARTBEAT_INTERVAL_S = 1.0
_HEARTBEAT = mavlink.MAVLink_heartbeat_message(
    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
)
_WISHES = (  # command, confirmation, first and second parameter; intervals in microseconds
    (mavlink.MAV_CMD_REQUEST_MESSAGE, 0, mavlink.MAVLINK_MSG_ID_HOME_POSITION, 0.0),
    (mavlink.MAV_CMD_REQUEST_MESSAGE, 0, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, 0.0),
    (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, mavlink.MAVLINK_MSG_ID_ATTITUDE, 1e6 / 50.0),
    (
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        0,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        1e6 / 30.0,
    ),
)


class Follower(asyncio.DatagramProtocol):
    """Hears a vehicle at `address` and shows the world as it sees it; an async context manager.

    faults: of the camera
    """

    def __init__(
        self, world: World, address: tuple[str, int], faults: Iterable[Fault] = ()
    ) -> None:
        self._world = world
        self._address = address
        self._mav = mavlink.MAVLink(None, _SYSTEM_ID, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._mav.robust_parsing = True
        self._vehicle: tuple[int, int] | None = None
        self._vehicle_address: tuple[str, int] | None = None
        self._time_s = -math.inf
        self._is_armed = False
        self.faults = FaultSchedule(faults)
        self._camera: CameraServer | None = None
        self._attitude: Any = None
        self._position: Any = None
        self._home_ned_m: Vector3 | None = None
        self._origin: GeoPoint | None = None

    @property
    def is_ready(self) -> bool:
        """Whether pose, home and origin are known."""
        known = (self._attitude, self._position, self._home_ned_m, self._origin)
        return all(value is not None for value in known)

    async def __aenter__(self) -> Self:
        self._transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: self, local_addr=self._address
        )
        return self

    async def __aexit__(self, *exc: object) -> None:
        self._transport.close()

    @property
    def address(self) -> tuple[str, int]:
        """IP and port at which it listens."""
        host, port = self._transport.get_extra_info("sockname")
        return host, port

    async def run(self, camera: CameraServer) -> None:
        """Keep the vehicle streaming and ask for what is missing, until cancelled.

        The camera is silent while there is nothing to show.
        """
        self._camera = camera
        camera.silent = not self.is_ready
        while True:
            if self._vehicle_address is not None:
                self._send(_HEARTBEAT)
            if not self.is_ready:
                self.ask()
            await asyncio.sleep(_HEARTBEAT_INTERVAL_S)

    def scene(self) -> Scene:
        """What the vehicle's camera looks at; only once `is_ready`."""
        assert self._home_ned_m is not None
        assert self._origin is not None
        frame = self._world.frame(self._home_ned_m, self._origin)
        pose, turning = self._pose(), self._attitude
        turn_rad_s = turning.rollspeed, turning.pitchspeed, turning.yawspeed
        return self._world.scene(pose, frame, pose.time_s, turn_rad_s)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Take what the vehicle sends (asyncio's callback)."""
        for message in self._mav.parse_buffer(data) or ():
            self._hear(message, addr)
        self.faults.advance(self._time_s, self._is_armed)
        if self._camera is not None:
            self._camera.silent = not self.is_ready

    def _hear(self, message: Any, address: tuple[str, int]) -> None:
        kind = message.get_type()
        sender = message.get_srcSystem(), message.get_srcComponent()
        if kind == "HEARTBEAT" and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
            if self._vehicle is None:
                self._vehicle = sender
            if sender == self._vehicle:
                self._is_armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if sender != self._vehicle:
            return
        self._vehicle_address = address
        if kind in ("ATTITUDE", "LOCAL_POSITION_NED"):
            self._take_pose(message)
        elif kind == "HOME_POSITION" and (self._home_ned_m is None or not self._is_armed):
            self._home_ned_m = (message.x, message.y, message.z)
        elif kind == "GPS_GLOBAL_ORIGIN":
            self._origin = GeoPoint(
                latitude_deg=message.latitude / 1e7,
                longitude_deg=message.longitude / 1e7,
                altitude_m=message.altitude / 1000.0,
            )

    def _take_pose(self, message: Any) -> None:
        """Keep the newest half of a pose; a reboot sets the clock back."""
        time_s = message.time_boot_ms / 1000.0
        has_rebooted = time_s < self._time_s - 1.0
        if has_rebooted:
            self._attitude = self._position = None
        self._time_s = time_s if has_rebooted else max(self._time_s, time_s)
        if message.get_type() == "ATTITUDE":
            self._attitude = message
        else:
            self._position = message

    def _pose(self) -> Pose:
        """The pose at the newest instant heard of."""
        p, a, now_s = self._position, self._attitude, self._time_s
        late_s = now_s - p.time_boot_ms / 1000.0
        turning_s = now_s - a.time_boot_ms / 1000.0
        return Pose(
            time_s=now_s,
            position_ned_m=(p.x + p.vx * late_s, p.y + p.vy * late_s, p.z + p.vz * late_s),
            velocity_ned_m_s=(p.vx, p.vy, p.vz),
            attitude_rad=(
                a.roll + a.rollspeed * turning_s,
                a.pitch + a.pitchspeed * turning_s,
                a.yaw + a.yawspeed * turning_s,
            ),
        )

    def ask(self) -> None:
        """Ask the vehicle, if one is heard, for home, origin and a pose at useful rates."""
        if self._vehicle is None:
            return
        for command in _WISHES:
            params = (*command, *(0.0,) * 5)
            self._send(mavlink.MAVLink_command_long_message(*self._vehicle, *params))

    def _send(self, message: Any) -> None:
        packet = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self._transport.sendto(packet, self._vehicle_address)
