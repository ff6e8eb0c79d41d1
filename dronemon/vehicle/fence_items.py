"""A vehicle's fence as MAVLink carries it: handed over item by item, and read back.

Source: MAVLink's mission protocol, with MAV_MISSION_TYPE_FENCE; PX4 v1.17, mavlink_mission.cpp.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias, TypeVar

from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CommandRejected, LinkLost, VehicleError
from dronemon.fence import FenceArea

MESSAGES = (
    *("MISSION_COUNT", "MISSION_ITEM_INT"),
    *("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"),
)
_FENCE: int = mavlink.MAV_MISSION_TYPE_FENCE
_INCLUSION: int = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
_EXCLUSION: int = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
_POLYGONS = (_INCLUSION, _EXCLUSION)
_CIRCLE_IN: int = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
_CIRCLES = (_CIRCLE_IN, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)
_COMMANDS = (*_POLYGONS, *_CIRCLES, mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT)
_DEG = 1e-7
_ROUNDING = 1
_TRIES, _SENDS = 3, 12
_RESEND_S = {"MISSION_COUNT": 1.5}
"""A count that comes twice ends PX4's transfer if the first has had an answer."""
_USUAL_RESEND_S = 0.6
_LIMIT_S = 60.0
_REFUSALS = {
    mavlink.MAV_MISSION_ERROR: "an error; is a ground station at its mission or fence just now?",
    mavlink.MAV_MISSION_UNSUPPORTED: "not supported",
    mavlink.MAV_MISSION_NO_SPACE: "no room; PX4 holds 64 corners and circles in all",
    mavlink.MAV_MISSION_DENIED: "denied",
}
Send = Callable[..., Awaitable[None]]
_T = TypeVar("_T")
Heard: TypeAlias = tuple[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class FenceItem:
    """One item of a fence.

    command: MAV_CMD_NAV_FENCE_...; frame: MAV_FRAME
    param1:  how many corners the polygon has, or the circle's radius in m
    x, y:    latitude and longitude in 1e-7 degrees; z: an altitude, which PX4 keeps and ignores
    """

    command: int
    frame: int = mavlink.MAV_FRAME_GLOBAL
    param1: float
    x: int
    y: int
    z: float = 0.0

    def is_like(self, other: FenceItem) -> bool:
        """Whether they are the same but for rounding."""
        return (
            self.command == other.command
            and math.isclose(self.param1, other.param1, rel_tol=1e-5, abs_tol=1e-3)
            and abs(self.x - other.x) <= _ROUNDING
            and abs(self.y - other.y) <= _ROUNDING
        )


def are_alike(a: Sequence[FenceItem], b: Sequence[FenceItem]) -> bool:
    """Whether two fences are the same but for rounding."""
    return len(a) == len(b) and all(one.is_like(other) for one, other in zip(a, b, strict=True))


def polygon_items(corners_deg: Sequence[tuple[float, float]]) -> tuple[FenceItem, ...]:
    """A polygon to stay in. corners_deg: latitude and longitude."""
    return tuple(
        FenceItem(
            command=_INCLUSION,
            param1=float(len(corners_deg)),
            x=round(latitude / _DEG),
            y=round(longitude / _DEG),
        )
        for latitude, longitude in corners_deg
    )


def areas_of(items: Sequence[FenceItem]) -> tuple[FenceArea, ...]:
    """The areas that items make. Raises VehicleError where they make none."""
    areas, index = [], 0
    while index < len(items):
        first = items[index]
        is_polygon = first.command in _POLYGONS
        part = items[index : index + (round(first.param1) if is_polygon else 1)]
        if is_polygon and (len(part) < max(round(first.param1), 3)):
            raise VehicleError(
                "the vehicle's own fence has a polygon without all its corners; mend or clear it "
                "with a ground station"
            )
        index += len(part)
        if is_polygon or first.command in _CIRCLES:
            areas.append(
                FenceArea(
                    is_inclusion=first.command in {_INCLUSION, _CIRCLE_IN},
                    corners_deg=tuple((item.x * _DEG, item.y * _DEG) for item in part),
                    radius_m=None if is_polygon else first.param1,
                )
            )
    return tuple(areas)


class FenceItems:
    """Both directions of the mission protocol with one autopilot, for its fence.

    send: sends a message, by name and fields
    """

    def __init__(self, send: Send) -> None:
        self._send = send
        self._heard = asyncio.Queue[Heard]()

    def take(self, name: str, fields: Mapping[str, Any]) -> None:
        """Take a message of the protocol; one of other missions is left out."""
        if fields.get("mission_type") == _FENCE:
            self._heard.put_nowait((name, fields))

    async def read(self) -> tuple[FenceItem, ...]:
        """Ask for the fence. Raises CommandRejected, LinkLost, VehicleError for nonsense."""
        return await self._try(self._read)

    async def write(self, items: Sequence[FenceItem]) -> None:
        """Replace the fence, and read it back. Raises CommandRejected, LinkLost."""
        await self._try(lambda: self._write(items))
        has = await self.read()
        if not are_alike(items, has):
            raise CommandRejected(
                f"the fence of {len(items)} corners and circles was handed over, and reads back "
                f"as another of {len(has)}; is a ground station at it? Try again"
            )

    async def _try(self, transfer: Callable[[], Awaitable[_T]]) -> _T:
        """Do a transfer, again where it is refused: it may have met another one."""
        try:
            async with asyncio.timeout(_LIMIT_S):
                for _ in range(_TRIES - 1):
                    with contextlib.suppress(CommandRejected):
                        return await transfer()
                return await transfer()
        except TimeoutError as exc:
            raise LinkLost(f"the fence is not handed over after {_LIMIT_S:g} s") from exc

    async def _read(self) -> tuple[FenceItem, ...]:
        self._heard = asyncio.Queue()
        _, found = await self._ask("MISSION_REQUEST_LIST", {}, _is_count)
        items = []
        for number in range(found["count"]):
            _, item = await self._ask(
                "MISSION_REQUEST_INT",
                {"seq": number},
                lambda name, fields: (
                    name == "MISSION_ITEM_INT" and fields.get("seq") == number  # noqa: B023
                ),
            )
            items.append(item_of(item))
        await self._send("MISSION_ACK", type=mavlink.MAV_MISSION_ACCEPTED, mission_type=_FENCE)
        return tuple(items)

    async def _write(self, items: Sequence[FenceItem]) -> None:
        self._heard = asyncio.Queue()

        def goes_on(name: str, fields: Mapping[str, Any]) -> bool:
            is_request = name in {"MISSION_REQUEST", "MISSION_REQUEST_INT"}
            return name == "MISSION_ACK" or (is_request and fields.get("seq") in range(len(items)))

        message: Heard = "MISSION_COUNT", {"count": len(items)}
        while True:
            name, fields = await self._ask(*message, goes_on)
            if name == "MISSION_ACK":
                return
            number = fields["seq"]
            usual = {"current": 0, "autocontinue": 1, "param2": 0.0, "param3": 0.0, "param4": 0.0}
            message = "MISSION_ITEM_INT", {"seq": number} | asdict(items[number]) | usual

    async def _ask(
        self,
        name: str,
        fields: Mapping[str, Any],
        is_answer: Callable[[str, Mapping[str, Any]], bool],
    ) -> Heard:
        """Send a message until it is answered. Raises CommandRejected, LinkLost."""
        for _ in range(_SENDS):
            await self._send(name, mission_type=_FENCE, **fields)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_RESEND_S.get(name, _USUAL_RESEND_S)):
                    while True:
                        answer, heard = await self._heard.get()
                        result = heard.get("type")
                        if answer == "MISSION_ACK" and result != mavlink.MAV_MISSION_ACCEPTED:
                            word = _REFUSALS.get(result, f"result {result}")
                            raise CommandRejected(f"the fence is refused: {word}")
                        if is_answer(answer, heard):
                            return answer, heard
        raise LinkLost(f"the vehicle does not answer {name} about its fence")


def _is_count(name: str, fields: Mapping[str, Any]) -> bool:
    return name == "MISSION_COUNT" and isinstance(fields.get("count"), int)


def item_of(fields: Mapping[str, Any]) -> FenceItem:
    """An item from its fields. Raises VehicleError for what is none."""
    try:
        item = FenceItem(
            command=int(fields["command"]),
            frame=int(fields["frame"]),
            param1=float(fields["param1"] or 0.0),  # NaN comes as None
            x=int(fields["x"]),
            y=int(fields["y"]),
            z=float(fields["z"] or 0.0),
        )
        is_place = abs(item.x) <= 90 / _DEG and abs(item.y) <= 180 / _DEG
        if item.command in _COMMANDS and math.isfinite(item.param1 + item.z) and is_place:
            return item
    except (LookupError, TypeError, ValueError, OverflowError):
        pass
    raise VehicleError(
        f"the vehicle's own fence cannot be read: {dict(fields)!r:.200} is no corner or circle; "
        "mend or clear it with a ground station"
    )
