"""MAVSDK 4.1 as a wire: messages of one autopilot in, messages and acknowledged commands out.

Telemetry is read message by message (`mavlink_direct`), since only those carry the vehicle's time.
Setpoints go out message by message too. MAVSDK's offboard plugin would repeat the last one at 20 Hz
by itself, also while this program hangs, and so defeat the autopilot's own failsafe. Nor are its
actions used: they take any component of the vehicle's system for the autopilot.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import json
import logging
import math
import socket
from collections.abc import Callable, Iterable
from typing import Any

from mavsdk import logging as mavsdk_logging
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, MavsdkConnectionError, MavsdkError
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync, MavlinkMessage
from mavsdk.asyncio.system import System
from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CommandUnconfirmed, LinkLost, LinkTimeout
from dronemon.mission.addresses import parse_udpin
from dronemon.vehicle import fence_items
from dronemon.vehicle.fence_items import FenceItems
from dronemon.vehicle.gimbal import GIMBAL_COMPONENTS, GIMBAL_MESSAGES
from dronemon.vehicle.neighbours import autopilots, choose
from dronemon.vehicle.parameters import Parameters
from dronemon.vehicle.px4 import (
    ANSWERS,
    AUTOPILOT_COMPONENT,
    NO_ANSWER,
    REMOTE_ID_STATUS,
    Command,
)

_LISTEN_S = 1.5
_SENDS, _RESEND_S = 4, 0.6
_PINGS = 8
_SEND_LIMIT_S = 2.0
_HEARTBEAT_S = 1.0
_REMOTE_IDS = tuple(getattr(mavlink, f"MAV_COMP_ID_ODID_TXRX_{number}") for number in (1, 2, 3))
_ALSO_OF: dict[str, tuple[int, ...]] = {
    REMOTE_ID_STATUS: _REMOTE_IDS,
    **dict.fromkeys(GIMBAL_MESSAGES, GIMBAL_COMPONENTS),
}
"""Messages that may be another component's of the vehicle than its autopilot's, and of which."""
_PARAMS = tuple(f"param{i}" for i in range(1, 8))
_Take = Callable[[str, dict[str, Any]], None]


class Wire:
    """The link to one autopilot; open inside its `async with`.

    take:       is told each message of the vehicle: its name and fields, `component` the sender's
    names:      of the messages that are wanted
    parameters, fence: of the vehicle
    own:        system and component by which it knows us

    A port that is held for this link is not asked whether it is free.
    Its limits are wall time.
    """

    def __init__(
        self,
        url: str,
        *,
        take: _Take,
        names: Iterable[str],
        is_port_held: bool,
        system_id: int | None,
        connect_timeout_s: float,
    ) -> None:
        self._results: dict[int, int] = {}  # the newest answer by command
        self._url = url
        self._take = take
        self._names = (*names, "COMMAND_ACK", "PING", "PARAM_VALUE", *fence_items.MESSAGES)
        self.parameters = Parameters(self.send, self.round_trip)
        self._is_port_held = is_port_held
        self.fence = FenceItems(self.send)
        self._wanted_id = system_id
        self.system_id = 0  # of the vehicle, once it is found
        self._connect_timeout_s = connect_timeout_s
        self._num_acks: dict[int, int] = {}
        self._beat_at = math.inf  # the event loop's time of the newest heartbeat
        self._answered = asyncio.Event()
        self._pings: dict[int, float] = {}  # when each was sent, by its stamp
        self._round_trip_s: float | None = None
        self._readers: list[asyncio.Task[None]] = []
        self._exit = contextlib.AsyncExitStack()

    async def __aenter__(self) -> Wire:
        try:
            await self._connect()
        except BaseException:
            await self._exit.aclose()
            raise
        return self

    async def __aexit__(self, *exc: Any) -> None:
        for reader in self._readers:
            reader.cancel()
        # A reader that fails cancels the body: only then has its group something to say.
        if isinstance(exc[1], asyncio.CancelledError):
            await self._exit.__aexit__(*exc)
        else:
            await self._exit.aclose()

    # Connecting

    async def _connect(self) -> None:
        mavsdk_logging._cmavsdk_lib.mavsdk_log_subscribe(_LOG_CALLBACK, None)
        if not self._is_port_held:
            _check_port(self._url)
        configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        self.own = (configuration.system_id, configuration.component_id)
        connections = await self._exit.enter_async_context(Mavsdk(configuration))
        try:
            await connections.add_any_connection(self._url)
        except MavsdkConnectionError as exc:
            raise LinkTimeout(
                f"cannot open {self._url}: {exc}; is the port free and the URL right?"
            ) from exc
        system = await self._find(connections)
        self.system_id = await system.get_system_id()
        self._direct = MavlinkDirectAsync(system)
        self._exit.callback(self._direct.destroy)
        self._beat_at = asyncio.get_running_loop().time()
        group = await self._exit.enter_async_context(asyncio.TaskGroup())
        self._readers = [
            group.create_task(self._read(name), name=f"mavlink {name}") for name in self._names
        ]
        self._readers.append(group.create_task(self._ask_for_heartbeats(), name="heartbeats"))

    async def _find(self, connections: Mavsdk) -> System:
        """Listen to who is there, and choose the vehicle. Raises LinkTimeout, WrongVehicle."""
        systems: dict[int, System] = {}
        heard: dict[tuple[int, int], dict[str, Any]] = {}
        is_there = asyncio.Event()

        async def listen(system: System) -> None:
            direct = MavlinkDirectAsync(system)
            try:
                async for message in direct.subscribe_message("HEARTBEAT"):
                    sender = message.system_id, message.component_id
                    heard[sender] = json.loads(message.fields_json)
                    if autopilots(heard):
                        is_there.set()
            finally:
                direct.destroy()

        async def discover() -> None:
            async for _ in connections.on_new_system():
                for system in await connections.get_systems():
                    number = await system.get_system_id()
                    if number not in systems:
                        systems[number] = system
                        listeners.append(group.create_task(listen(system), name=f"system {number}"))

        async with asyncio.TaskGroup() as group:
            listeners = [group.create_task(discover(), name="discovery")]
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._connect_timeout_s):
                    await is_there.wait()
                await asyncio.sleep(_LISTEN_S)
            for listener in listeners:
                listener.cancel()
        if not autopilots(heard):
            raise LinkTimeout(
                f"no autopilot heard on {self._url} after {self._connect_timeout_s:g} s; "
                "is the vehicle on and streaming there?"
            )
        return systems[choose(heard, self._wanted_id, self.own, self._url)]

    # Reading

    async def _read(self, name: str) -> None:
        senders = (AUTOPILOT_COMPONENT, *_ALSO_OF.get(name, ()))
        async for message in self._direct.subscribe_message(name):
            if message.system_id != self.system_id or message.component_id not in senders:
                continue
            try:
                fields = json.loads(message.fields_json)
            except ValueError:
                fields = {}
            if name == "COMMAND_ACK":
                self._take_ack(fields)
            elif name == "PING":
                self._take_ping(fields)
            elif name == "PARAM_VALUE":
                self.parameters.take(fields)
            elif name in fence_items.MESSAGES:
                if _addressee(fields) == self.own:
                    self.fence.take(name, fields)
            else:
                self._take(name, fields | {"component": message.component_id})
                if name == "HEARTBEAT":
                    self._beat_at = asyncio.get_running_loop().time()

    async def _ask_for_heartbeats(self) -> None:
        """Ask where they stay away: there is one a second, and any may be lost."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(_HEARTBEAT_S)
            if loop.time() - self._beat_at > 2.0 * _HEARTBEAT_S:
                with contextlib.suppress(LinkLost):
                    await self.post(Command.send(mavlink.MAVLINK_MSG_ID_HEARTBEAT))

    def _take_ack(self, fields: dict[str, Any]) -> None:
        command, result = fields.get("command"), fields.get("result")
        if isinstance(command, int) and isinstance(result, int):
            self._results[command] = result
            if result != mavlink.MAV_RESULT_IN_PROGRESS:
                self._num_acks[command] = self._num_acks.get(command, 0) + 1
                self._answered.set()

    def _take_ping(self, fields: dict[str, Any]) -> None:
        sent_at = self._pings.get(fields.get("time_usec", 0))
        if _addressee(fields) == self.own and sent_at is not None:
            self._round_trip_s = asyncio.get_running_loop().time() - sent_at
            self._answered.set()

    # Sending

    async def send(self, name: str, **fields: float | str | None) -> None:
        """Send one message to the autopilot; None is NaN. Raises LinkLost."""
        target = {"target_system": self.system_id, "target_component": AUTOPILOT_COMPONENT}
        await self._send(name, target | fields)

    async def _send(self, name: str, fields: dict[str, Any]) -> None:
        message = MavlinkMessage(message_name=name, fields_json=json.dumps(fields))
        try:
            async with asyncio.timeout(_SEND_LIMIT_S):
                await self._direct.send_message(message)
        except TimeoutError as exc:
            raise LinkLost(
                f"nothing can be sent to {self._url}: it takes longer than {_SEND_LIMIT_S:g} s"
            ) from exc
        except MavsdkError as exc:
            raise LinkLost(f"nothing can be sent to {self._url}: {exc}") from exc

    async def post(self, command: Command, confirmation: int = 0) -> None:
        """Send a command once. Raises LinkLost."""
        params = (*command.params, *(math.nan,) * (len(_PARAMS) - len(command.params)))
        fields = {
            name: None if math.isnan(value) else value
            for name, value in zip(_PARAMS, params, strict=True)
        }
        await self.send("COMMAND_LONG", command=command.number, confirmation=confirmation, **fields)

    async def command(self, command: Command, check: Callable[[], None] = lambda: None) -> None:
        """Send a command until it is acknowledged, which only says that it came.

        check: raises what forbids to send it, or to send it once more

        Raises CommandUnconfirmed, LinkLost.
        """
        number = command.number
        num_acks = self._num_acks.get(number, 0)
        for confirmation in range(_SENDS):
            check()
            await self.post(command, confirmation)
            await self._wait(lambda: self._num_acks.get(number, 0) > num_acks)
            if self._num_acks.get(number, 0) > num_acks:
                return
        self._results.pop(number, None)
        raise CommandUnconfirmed(f"no answer to command {number}, sent {_SENDS} times")

    def answer(self, command: Command) -> str:
        """The autopilot's newest answer to a command, in words."""
        result = self._results.get(command.number)
        return NO_ANSWER if result is None else ANSWERS.get(result, f"result {result}")

    async def round_trip(self) -> float:
        """Send pings until one is answered. -> the wall time that it took, in s.

        Whatever the vehicle sent before the answer has been heard by then.

        Raises LinkLost.
        """
        self._pings, self._round_trip_s = {}, None
        for _ in range(_PINGS):
            sent_at = asyncio.get_running_loop().time()
            stamp_us = round(sent_at * 1e6)
            self._pings[stamp_us] = sent_at
            everyone = {"target_system": 0, "target_component": 0}
            await self._send("PING", {"time_usec": stamp_us, "seq": 0} | everyone)
            await self._wait(lambda: self._round_trip_s is not None)
            if self._round_trip_s is not None:
                return self._round_trip_s
        raise LinkLost(
            f"the vehicle on {self._url} answers no ping within {_PINGS * _RESEND_S:.0f} s"
        )

    async def _wait(self, condition: Callable[[], bool]) -> None:
        """Wait for an answer, until it is time to ask again."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_RESEND_S):
                while not condition():
                    self._answered.clear()
                    await self._answered.wait()


def _addressee(fields: dict[str, Any]) -> tuple[object, object]:
    return fields.get("target_system"), fields.get("target_component")


def _check_port(url: str) -> None:
    """Refuse a port that another program listens on: only one of the two would hear the vehicle."""
    try:
        address = parse_udpin(url)
    except ValueError:
        return
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(address)
        except OSError as exc:
            if exc.errno == errno.EADDRINUSE:
                raise LinkTimeout(
                    f"another program listens on {url}, and only one of the two would hear the "
                    "vehicle; end it, or give each a port of its own"
                ) from exc


def _to_logging(_level: int, message: bytes, _file: bytes, _line: int, _data: object) -> bool:
    """Pass what MAVSDK says to Python's logging, for whoever looks for it there.

    As bytes, which `mavsdk.log_subscribe` does not: it cites vehicles, whose texts may be anything.
    """
    logging.getLogger("mavsdk").debug("%r", message)
    return True  # it does not print it itself


_LOG_CALLBACK = mavsdk_logging.LogCallback(_to_logging)
