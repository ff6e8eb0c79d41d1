"""A vehicle's parameters by name: asked for, set, and read back.

PX4 answers a parameter that it does not have with silence, and so does a link that lost the answer.
A ping after the questions tells the two apart: it is answered after them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CommandRejected, OptionError

_INT32: int = mavlink.MAV_PARAM_TYPE_INT32
_REAL32: int = mavlink.MAV_PARAM_TYPE_REAL32
_TRIES = 12
Send = Callable[..., Awaitable[None]]


class Parameters:
    """Both directions of the parameter protocol with one autopilot.

    send:       sends a message, by name and fields
    round_trip: returns when what was sent before has been answered; raises LinkLost
    """

    def __init__(self, send: Send, round_trip: Callable[[], Awaitable[object]]) -> None:
        self._send = send
        self._round_trip = round_trip
        self._heard: dict[str, tuple[int, float]] = {}  # type and value

    def take(self, fields: Mapping[str, Any]) -> None:
        """Take a PARAM_VALUE; one that cannot be is left out."""
        name, kind, value = (fields.get(f"param_{key}") for key in ("id", "type", "value"))
        if isinstance(name, str) and kind in (_INT32, _REAL32):
            self._heard[name] = kind, decoded(kind, value)

    async def read(self, names: Iterable[str]) -> dict[str, float]:
        """Ask for parameters. -> values of those that the vehicle has. Raises LinkLost.

        One that cannot be read, such as a negative whole number, which MAVSDK does not hand over,
        is NaN.
        """
        wanted = tuple(names)
        for name in wanted:
            self._heard.pop(name, None)
        for _ in range(_TRIES):
            if not (missing := [name for name in wanted if name not in self._heard]):
                break
            for name in missing:
                await self._send("PARAM_REQUEST_READ", param_id=name, param_index=-1)
            await self._round_trip()
        return {name: self._heard[name][1] for name in wanted if name in self._heard}

    async def write(self, name: str, value: float) -> None:
        """Set a parameter, until it reads back as it was set.

        Raises OptionError for a value that it cannot have, CommandRejected, LinkLost.
        """
        present = (await self.read([name])).get(name)
        if present is None:
            raise CommandRejected(f"the vehicle has no parameter {name}")
        kind = self._heard[name][0]
        reads = as_float32(value) if kind == _REAL32 else value
        for _ in range(_TRIES):
            if present == reads:
                return
            await self._send(
                "PARAM_SET", param_id=name, param_type=kind, param_value=encoded(name, kind, value)
            )
            present = (await self.read([name])).get(name, present)
        raise CommandRejected(
            f"{name}: asked for {value:g} {_TRIES} times, the vehicle says {present:g}"
        )


def as_float32(value: float) -> float:
    """The nearest number that a parameter can have. Raises OptionError if there is none."""
    try:
        nearest: float = struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError as exc:
        raise OptionError(f"{value:g} is more than a parameter can hold") from exc
    return nearest


def decoded(kind: int, value: object) -> float:
    """The number that PARAM_VALUE carries: an int32 is packed bytewise into the float."""
    try:
        packed = struct.pack("<f", value)
    except (OverflowError, struct.error):
        return math.nan
    number: float = struct.unpack("<f" if kind == _REAL32 else "<i", packed)[0]
    return float(number)


def encoded(name: str, kind: int, value: float) -> float:
    """What PARAM_SET must carry. Raises OptionError for what the parameter's type does not take."""
    if kind == _REAL32:
        return value
    if value != math.floor(value):
        raise OptionError(f"{name} is a whole number, not {value:g}")
    if not 0 <= value < 2**31:
        raise OptionError(
            f"{name}={value:g}: a whole number below 0 or above {2**31 - 1} cannot be sent over "
            "this link; set it with a ground station"
        )
    packed: float = struct.unpack("<f", struct.pack("<i", int(value)))[0]
    if not math.isfinite(packed):
        raise OptionError(f"{name}={value:g} cannot be sent over this link")
    return packed
