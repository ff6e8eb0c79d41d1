"""What is in the air on one UDP port: vehicles and others, which speak and answer commands."""

from __future__ import annotations

import asyncio
import contextlib
import socket

from pymavlink.dialects.v20 import common as mavlink
from simulated_vehicle import free_udp_port

from dronemon.vehicle import Mode
from dronemon.vehicle.mavsdk_link import MavsdkLink
from dronemon.vehicle.px4 import NUMBERS

PX4 = mavlink.MAV_AUTOPILOT_PX4
PERIOD_S = 0.04


class Air:
    """Speakers by system, component and kind, each a function that gives its next message.

    step_ms:    how far their clocks go on from one message to the next
    told:       the messages that were sent to the vehicles
    results:    what a command is answered, if it is not accepted; None: with silence
    on_command: is called with a command's number
    """

    def __init__(self):
        self.port = free_udp_port()
        self.url = f"udpin://127.0.0.1:{self.port}"
        self.time_ms, self.step_ms = 100_000, 200
        self.speakers = {}
        self.told = []
        self.results = {}
        self.on_command = lambda number: None
        self._packers = {}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True

    def beats(self, sender, mode=Mode.HOLD, *, kind=2, autopilot=PX4, is_armed=False, status=4):
        main, sub = NUMBERS[mode]
        fields = (kind, autopilot, 128 * is_armed, main << 16 | sub << 24, status, 3)
        self.speakers[*sender, "beat"] = lambda: mavlink.MAVLink_heartbeat_message(*fields)

    def flies(self, sender, north_m=0.0, *, down_m=0.0, offset_ms=0, roll=0.0, who=""):
        self.speakers[*sender, f"turn{who}"] = lambda: mavlink.MAVLink_attitude_message(
            self.time_ms + offset_ms, roll, 0, 0, 0, 0, 0
        )
        self.speakers[*sender, f"place{who}"] = lambda: mavlink.MAVLink_local_position_ned_message(
            self.time_ms + offset_ms, north_m, 0, down_m, 0, 0, 0
        )

    def says(self, text, severity=3):
        self._send((1, 1), mavlink.MAVLink_statustext_message(severity, text.encode(), 0, 0))

    def throws(self, datagram):
        self._socket.sendto(datagram, ("127.0.0.1", self.port))

    def commands(self):
        return [message.command for message in self.told if message.get_type() == "COMMAND_LONG"]

    def num_told(self, name):
        return sum(message.get_type() == name for message in self.told)

    def _send(self, sender, message):
        packer = self._packers.setdefault(sender, mavlink.MAVLink(None, *sender))
        self.throws(message.pack(packer))
        packer.seq = (packer.seq + 1) % 256

    def _hear(self):
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            while data := self._socket.recv(4096):
                for message in self._parser.parse_buffer(data) or ():
                    self._answer(message)

    def _answer(self, message):
        if message.get_srcSystem() != 245:
            return
        self.told.append(message)
        if message.get_type() == "COMMAND_LONG":
            self.on_command(message.command)
            if (result := self.results.get(message.command, 0)) is not None:
                ack = mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, 245, 190)
                self._send((1, 1), ack)
        elif message.get_type() == "PING" and not message.target_system:
            self._send(
                (1, 1), mavlink.MAVLink_ping_message(message.time_usec, message.seq, 245, 190)
            )

    async def _speak(self):
        while True:
            self.time_ms += self.step_ms
            self._hear()
            for (system, component, _), message in list(self.speakers.items()):
                self._send((system, component), message())
            await asyncio.sleep(PERIOD_S)

    def run(self, story, limit_s=30.0, **options):
        """Tell a story with a link to what is in the air."""

        async def tell():
            speaking = asyncio.create_task(self._speak())
            try:
                async with MavsdkLink(self.url, **options) as link:
                    await story(link)
            finally:
                speaking.cancel()
                self._socket.close()

        asyncio.run(asyncio.wait_for(tell(), limit_s))
