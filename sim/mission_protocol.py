"""Missions, fences and rally points as ground stations upload and read them back.

Missions and rally points are stored, not flown.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

MAX_ITEMS = 2000
_MAX_ITEMS = {
    mavlink.MAV_MISSION_TYPE_MISSION: MAX_ITEMS,
    mavlink.MAV_MISSION_TYPE_FENCE: 64,
    mavlink.MAV_MISSION_TYPE_RALLY: 32,
}
_LEAST_CORNERS = 3
_POLYGONS = (
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)


class MissionStore:
    """The items of each mission type, each upload a new list, and the mission's current item."""

    def __init__(self) -> None:
        self.items: dict[int, list[Any]] = {kind: [] for kind in _MAX_ITEMS}
        self.current = 0


class MissionProtocol:
    """One link's side of the mission protocol; `answer` gives the replies to a message."""

    def __init__(self, store: MissionStore) -> None:
        self._store = store
        self._upload: tuple[int, int, list[Any]] | None = None  # type, count, items so far

    def answer(self, message: Any) -> list[Any]:
        """Replies to one message; none if it is not of this protocol."""
        handlers = {
            "MISSION_COUNT": self._begin_upload,
            "MISSION_ITEM_INT": self._take_item,
            "MISSION_REQUEST_LIST": self._send_count,
            "MISSION_REQUEST_INT": self._send_item,
            "MISSION_REQUEST": self._send_item,
            "MISSION_CLEAR_ALL": self._clear,
            "MISSION_SET_CURRENT": self._set_current,
        }
        handler = handlers.get(message.get_type())
        return [] if handler is None else handler(message)

    def _begin_upload(self, message: Any) -> list[Any]:
        if message.mission_type not in self._store.items:
            return [_mission_ack(message, mavlink.MAV_MISSION_UNSUPPORTED)]
        if message.count > _MAX_ITEMS[message.mission_type]:
            return [_mission_ack(message, mavlink.MAV_MISSION_NO_SPACE)]
        if message.count == 0:
            return self._finish(message, [])
        self._upload = (message.mission_type, message.count, [])
        return [_request(message, 0)]

    def _take_item(self, message: Any) -> list[Any]:
        """Take the next item; a repeated one is answered with the request for the next again."""
        if self._upload is None:
            stored = self._store.items.get(message.mission_type, [])
            is_repeat = message.seq == len(stored) - 1
            result = mavlink.MAV_MISSION_ACCEPTED if is_repeat else mavlink.MAV_MISSION_ERROR
            return [_mission_ack(message, result)]
        mission_type, count, items = self._upload
        if message.mission_type != mission_type:
            return [_mission_ack(message, mavlink.MAV_MISSION_INVALID_SEQUENCE)]
        if message.command in _POLYGONS and message.param1 < _LEAST_CORNERS:
            self._upload = None
            return [_mission_ack(message, mavlink.MAV_MISSION_ERROR)]
        if message.seq == len(items):
            items.append(message)
        return (
            [_request(message, len(items))] if len(items) < count else self._finish(message, items)
        )

    def _finish(self, message: Any, items: list[Any]) -> list[Any]:
        self._upload = None
        self._store.items[message.mission_type] = items
        if message.mission_type == mavlink.MAV_MISSION_TYPE_MISSION:
            self._store.current = 0
        return [_mission_ack(message, mavlink.MAV_MISSION_ACCEPTED)]

    def _send_count(self, message: Any) -> list[Any]:
        if message.mission_type not in self._store.items:
            return [_mission_ack(message, mavlink.MAV_MISSION_UNSUPPORTED)]
        count = len(self._store.items[message.mission_type])
        return [mavlink.MAVLink_mission_count_message(*_to(message), count, message.mission_type)]

    def _send_item(self, message: Any) -> list[Any]:
        items = self._store.items.get(message.mission_type, [])
        if message.seq >= len(items):
            return [_mission_ack(message, mavlink.MAV_MISSION_INVALID_SEQUENCE)]
        i = items[message.seq]
        head = (i.seq, i.frame, i.command, int(i.seq == self._store.current), i.autocontinue)
        rest = (i.param1, i.param2, i.param3, i.param4, i.x, i.y, i.z, i.mission_type)
        return [mavlink.MAVLink_mission_item_int_message(*_to(message), *head, *rest)]

    def _clear(self, message: Any) -> list[Any]:
        self._upload = None
        if message.mission_type == mavlink.MAV_MISSION_TYPE_ALL:
            self._store.items = {kind: [] for kind in _MAX_ITEMS}
        elif message.mission_type in self._store.items:
            self._store.items[message.mission_type] = []
        else:
            return [_mission_ack(message, mavlink.MAV_MISSION_UNSUPPORTED)]
        return [_mission_ack(message, mavlink.MAV_MISSION_ACCEPTED)]

    def _set_current(self, message: Any) -> list[Any]:
        count = len(self._store.items[mavlink.MAV_MISSION_TYPE_MISSION])
        if message.seq < count:
            self._store.current = message.seq
        return [mavlink.MAVLink_mission_current_message(self._store.current, count)]


def _to(message: Any) -> tuple[int, int]:
    """Where the reply goes."""
    return message.get_srcSystem(), message.get_srcComponent()


def _mission_ack(message: Any, result: int) -> Any:
    return mavlink.MAVLink_mission_ack_message(*_to(message), result, message.mission_type)


def _request(message: Any, sequence: int) -> Any:
    where = _to(message)
    return mavlink.MAVLink_mission_request_int_message(*where, sequence, message.mission_type)
