"""Datagrams that a MAVLink link may get: messages with any values, spoilt ones, garbage."""

from __future__ import annotations

import contextlib
import functools
import struct
from collections.abc import Callable, Sequence
from typing import Any

from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

_CODES = {
    "char": "c",
    "int8_t": "b",
    "uint8_t": "B",
    "int16_t": "h",
    "uint16_t": "H",
    "int32_t": "i",
    "uint32_t": "I",
    "int64_t": "q",
    "uint64_t": "Q",
    "float": "f",
    "double": "d",
}
_EXTREMES = (
    *(0, 1, 2, 100, 255, 65535, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1, -1, -128, -(2**31)),
    *(0.0, 0.5, -1.0, 1e30, -1e30, float("nan"), float("inf"), -float("inf")),
)
_KINDS = sorted(mavlink.mavlink_map.values(), key=lambda kind: kind.id)


@functools.cache
def _payloads(kind: Any) -> st.SearchStrategy[bytes]:
    """What a message to system 1 may hold: anything, and here and there known or extreme values."""
    known, to_system_1, size = [(0, b"")], [], 0  # where, and which bytes
    for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        code = _CODES[kind.fieldtypes[kind.fieldnames.index(name)]]
        enum = mavlink.enums.get(kind.fieldenums_by_name.get(name), ())
        for value in (*enum, *_EXTREMES):
            with contextlib.suppress(struct.error, OverflowError):  # its type has no such value
                known.append((size, struct.pack(f"<{code}", value)))
        if name in ("target_system", "target_component"):
            to_system_1.append((size, b"\1"))
        size += struct.calcsize(code) * max(length, 1)

    def changed(payload: bytes, values: list[tuple[int, bytes]]) -> bytes:
        for start, value in (*to_system_1, *values):
            payload = payload[:start] + value + payload[start + len(value) :]
        return payload

    anything = st.just(bytes(size)) | st.binary(min_size=size, max_size=size)
    return st.builds(changed, anything, st.lists(st.sampled_from(known), max_size=6))


@st.composite
def _frames(draw: Callable[..., Any], kinds: st.SearchStrategy[Any], mav: Any) -> bytes:
    """A message as it goes over the wire, with a true check sum."""
    kind = draw(kinds)
    message = mavlink.MAVLink_message(kind.id, kind.msgname)
    return bytes(message._pack(mav, kind.crc_extra, draw(_payloads(kind))))


def _spoil(data: bytes, place: int, put: bytes) -> bytes:
    place %= len(data)
    return data[:place] + put + data[place + 1 :]


def datagrams(names: Sequence[str], sender: tuple[int, int]) -> st.SearchStrategy[bytes]:
    """Datagrams of one sender, mostly messages whose names begin with one of these."""
    meant = [kind for kind in _KINDS if kind.msgname.startswith(tuple(names))]
    kinds = st.sampled_from(meant * (2 * len(_KINDS) // len(meant)) + _KINDS)
    frames, places = _frames(kinds, mavlink.MAVLink(None, *sender)), st.integers(0, 300)
    spoilt = st.builds(_spoil, frames, places, st.binary(max_size=2))
    cut = st.builds(lambda data, length: data[: length % len(data)], frames, places)
    joined = st.lists(frames, min_size=2, max_size=3).map(b"".join)
    return st.one_of(frames, frames, frames, frames, joined, spoilt, cut, st.binary(max_size=300))
