"""The autopilot's MAVLink links: streams out, commands in, over UDP on loopback.

Each link is like one of PX4's: it streams to a fixed address from the start, at its own rates, and
everyone who writes to it may command.
"""

from __future__ import annotations

import asyncio
import math
import random
import time
from collections import deque
from collections.abc import Mapping
from typing import Any, cast

from pymavlink.dialects.v20 import common as mavlink

from sim.autopilot import BOOT_S, STEP_S, Autopilot
from sim.commands import (
    ACCEPTED,
    DENIED,
    REJECTED,
    UNSUPPORTED,
    Command,
    execute,
    setpoint_from_global,
    setpoint_from_local,
    whole,
)
from sim.line import FaultyLine
from sim.mission_protocol import MissionProtocol
from sim.parameters import INDEX, TABLE
from sim.streams import COMPONENTS, STREAMS, Builder

_DATAGRAM_BYTES = 1200
_CHUNK_BYTES = 50
_BROADCAST = (
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
    mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION,
)
"""Commands that are obeyed without naming this system."""
_GCS_TIMEOUT_S = 3.0
_SIGNING_EPOCH_S = 1_420_070_400
"""1 January 2015, from which MAVLink's signatures count in 10 microseconds."""


class _Stream:
    """One message of one link: its builder and when it is due."""

    __slots__ = ("build", "due_s", "interval_s")

    def __init__(self, build: Builder, rate_hz: float) -> None:
        self.build = build
        self.interval_s = 1.0 / rate_hz if rate_hz > 0.0 else 0.0
        self.due_s = BOOT_S


class MavlinkLink(asyncio.DatagramProtocol):
    """One UDP link to `remote`.

    faults:      kinds that are active now -> value
    rng:         by which faults of the line happen
    signing_key: 32 bytes; with it all is signed, and only what is signed is heard
    """

    def __init__(
        self,
        autopilot: Autopilot,
        remote: tuple[str, int],
        faults: Mapping[str, float],
        rng: random.Random,
        signing_key: bytes | None = None,
    ) -> None:
        self._autopilot = autopilot
        self._remote = remote
        self._faults = faults
        self._inward, self._outward = FaultyLine(faults, rng), FaultyLine(faults, rng)
        self._mav = _packer(mavlink.MAV_COMP_ID_AUTOPILOT1, signing_key)
        self._others = {
            number: _packer(component, signing_key) for number, component in COMPONENTS.items()
        }
        self._gcs_heard_s = -_GCS_TIMEOUT_S
        self._buffer = bytearray()
        self._transport: asyncio.DatagramTransport | None = None
        self._restart()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the socket (asyncio's callback)."""
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Handle what was sent to the vehicle (asyncio's callback)."""
        if data:
            self._inward.put(data, self._autopilot.time_s)
            self._hear()
            self.flush()

    def _hear(self) -> None:
        for data in self._inward.take(self._autopilot.time_s):
            if "deaf" in self._faults or self._autopilot.time_s < BOOT_S:
                continue
            for message in self._mav.parse_buffer(data) or ():
                self._receive(message)

    def close(self) -> None:
        """Close the socket."""
        if self._transport is not None:
            self._transport.close()

    def stream(self, texts: list[tuple[int, str]]) -> None:
        """Send what is due at this step, and texts to a ground station."""
        now_s = self._autopilot.time_s
        if self._boots != self._autopilot.num_boots:
            self._restart()
        self._hear()
        self._deliver()
        if now_s < BOOT_S:
            return
        while self._pending:
            self._send(self._pending.popleft())
        for stream in self._streams.values():
            if stream.interval_s > 0.0 and now_s >= stream.due_s:
                stream.due_s = max(stream.due_s + stream.interval_s, now_s - STEP_S)
                self._send(stream.build(self._autopilot))
        index = next(self._parameters_left, None)
        if index is not None:
            self._send(self._parameter(index))
        if texts and time.monotonic() - self._gcs_heard_s < _GCS_TIMEOUT_S:
            for severity, text in texts:
                self._send_text(severity, text.encode())

    def flush(self) -> None:
        """Hand what was sent to the network."""
        if self._buffer and "silence" not in self._faults:
            self._outward.put(bytes(self._buffer), self._autopilot.time_s)
        self._buffer.clear()
        self._deliver()

    def _deliver(self) -> None:
        for data in self._outward.take(self._autopilot.time_s):
            if self._transport is not None:
                self._transport.sendto(data, self._remote)

    def _restart(self) -> None:
        """Begin with the default rates and nothing under way, as after a reboot."""
        self._boots = self._autopilot.num_boots
        self._inward.clear()
        self._outward.clear()
        self._streams = {number: _Stream(*spec) for number, spec in STREAMS.items()}
        self._missions = MissionProtocol(self._autopilot.missions)
        self._pending: deque[Any] = deque()
        self._parameters_left = iter(range(0))
        self._text_id = 0

    def _send(self, message: Any) -> None:
        if message is None:
            return
        packer = self._others.get(message.get_msgId(), self._mav)
        packer.srcSystem = self._system_id
        packet = message.pack(packer)
        packer.seq = (packer.seq + 1) % 256
        if len(self._buffer) + len(packet) > _DATAGRAM_BYTES:
            self.flush()
        self._buffer += packet

    def _send_text(self, severity: int, text: bytes) -> None:
        """Send a text in chunks of one id; none follows one that is just full, as PX4 has it."""
        for sequence, start in enumerate(range(0, len(text), _CHUNK_BYTES)):
            chunk = text[start : start + _CHUNK_BYTES]
            self._send(mavlink.MAVLink_statustext_message(severity, chunk, self._text_id, sequence))
        self._text_id = (self._text_id + 1) % 2**16

    @property
    def _system_id(self) -> int:
        return int(self._autopilot.parameters["MAV_SYS_ID"])

    def _receive(self, message: Any) -> None:
        if getattr(message, "target_system", 0) not in (0, self._system_id):
            return
        if getattr(message, "target_component", 0) not in (0, mavlink.MAV_COMP_ID_AUTOPILOT1):
            return
        kind = message.get_type()
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            if message.target_system or message.command in _BROADCAST:
                self._obey(message)
        elif kind == "SET_MODE" and "reject" not in self._faults:
            mode = (message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24)
            params = (float(message.base_mode), *map(float, mode), *[math.nan] * 4)
            execute(self._autopilot, Command(number=mavlink.MAV_CMD_DO_SET_MODE, params=params))
        elif kind.startswith("SET_POSITION_TARGET"):
            self._take_setpoint(message)
        elif kind.startswith("PARAM_"):
            self._serve_parameters(message)
        elif kind.startswith("MISSION_"):
            for reply in self._missions.answer(message):
                self._send(reply)
        else:
            self._serve_link(message)

    def _serve_link(self, message: Any) -> None:
        """Answer what keeps a link alive, and refuse file transfer."""
        kind, now_us = message.get_type(), round(self._autopilot.time_s * 1e6)
        sender = message.get_srcSystem(), message.get_srcComponent()
        if kind == "HEARTBEAT" and message.type == mavlink.MAV_TYPE_GCS:
            self._gcs_heard_s = time.monotonic()
        elif kind == "PING" and message.target_system == 0:
            self._send(mavlink.MAVLink_ping_message(message.time_usec, message.seq, *sender))
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self._send(mavlink.MAVLink_timesync_message(now_us * 1000, message.ts1))
        elif kind == "FILE_TRANSFER_PROTOCOL":
            asked = bytes(message.payload)
            sequence = (int.from_bytes(asked[:2], "little") + 1) % 65536
            head = (
                sequence.to_bytes(2, "little"),
                (asked[2], mavlink.MAV_FTP_OPCODE_NAK, 1, asked[3]),
            )
            payload = [
                *head[0],
                *head[1],
                0,
                0,
                *asked[8:12],
                mavlink.MAV_FTP_ERR_UNKNOWNCOMMAND,
                *([0] * 238),
            ]
            self._send(mavlink.MAVLink_file_transfer_protocol_message(0, *sender, payload))

    def _take_setpoint(self, message: Any) -> None:
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            setpoint = setpoint_from_local(message, self._autopilot.estimate.yaw)
        else:
            setpoint = setpoint_from_global(message, self._autopilot)
        if setpoint is not None:
            self._autopilot.take_offboard(setpoint)

    def _obey(self, message: Any) -> None:
        """Execute a command and acknowledge it; a mode change is acknowledged twice, as by PX4."""
        command = Command.from_message(message)
        if "reject" in self._faults:
            result = REJECTED
        else:
            result = self._serve_messages(command)
            if result == UNSUPPORTED:
                result = execute(self._autopilot, command)
        ack = _command_ack(message, result)
        if command.number == mavlink.MAV_CMD_DO_SET_MODE:
            self._send(_command_ack(message, ACCEPTED))
            self._pending.append(ack)
        else:
            self._send(ack)

    def _serve_messages(self, command: Command) -> int:
        """Requests for messages and their rates, which concern this link alone. -> MAV_RESULT."""
        if command.number == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return self._send_once(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        if command.number == mavlink.MAV_CMD_GET_HOME_POSITION:
            return self._send_once(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
        if command.number == mavlink.MAV_CMD_REQUEST_MESSAGE:
            return self._send_once(whole(command.params[0]))
        number = whole(command.params[0])
        stream = None if number in COMPONENTS else self._streams.get(number)
        if command.number == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
            if not 0 <= number < 65536:
                return DENIED
            interval_us = round(stream.interval_s * 1e6) if stream is not None else 0
            self._send(mavlink.MAVLink_message_interval_message(number, interval_us or -1))
            return ACCEPTED
        if command.number == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return DENIED if stream is None else self._set_interval(stream, command.params[1])
        return UNSUPPORTED

    def _send_once(self, number: int) -> int:
        stream = self._streams.get(number)
        message = None if stream is None else stream.build(self._autopilot)
        if message is None:
            return DENIED
        # After the acknowledgement, in the order in which PX4 sends them.
        self._pending.append(message)
        return ACCEPTED

    def _set_interval(self, stream: _Stream, interval_us: float) -> int:
        """Change a rate; 0 asks for the default, -1 turns the stream off."""
        if interval_us == 0.0:
            rate_hz = next(r for build, r in STREAMS.values() if build is stream.build)
            interval_us = 1e6 / rate_hz if rate_hz > 0.0 else -1.0
        stream.interval_s = max(interval_us / 1e6, STEP_S) if interval_us > 0.0 else 0.0
        stream.due_s = self._autopilot.time_s
        return ACCEPTED

    def _serve_parameters(self, message: Any) -> None:
        parameters = self._autopilot.parameters
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            self._parameters_left = iter(range(len(TABLE)))
            return
        if kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            index = message.param_index if message.param_index < len(TABLE) else None
        elif kind in ("PARAM_REQUEST_READ", "PARAM_SET"):
            index = INDEX.get(message.param_id)
        else:
            return
        if index is None:
            self._autopilot.say(mavlink.MAV_SEVERITY_ERROR, f"unknown param: {message.param_id}")
            return
        if kind == "PARAM_SET":
            parameters.from_wire(message.param_id, message.param_value, message.param_type)
        self._send(self._parameter(index))

    def _parameter(self, index: int) -> Any:
        name, value, kind = self._autopilot.parameters.on_wire(index)
        return mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(TABLE), index)


def _packer(component: int, signing_key: bytes | None) -> mavlink.MAVLink:
    packer = mavlink.MAVLink(None, srcComponent=component)
    packer.robust_parsing = True
    if signing_key is not None:
        signing = packer.signing
        signing.secret_key, signing.sign_outgoing = signing_key, True
        signing.timestamp = round((time.time() - _SIGNING_EPOCH_S) * 1e5)
    return packer


def _command_ack(message: Any, result: int) -> Any:
    sender = message.get_srcSystem(), message.get_srcComponent()
    return mavlink.MAVLink_command_ack_message(message.command, result, 255, 0, *sender)
