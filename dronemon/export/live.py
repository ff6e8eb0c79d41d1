"""Sightings sent while it flies, in datagrams: Cursor-on-Target, or MAVLink to a ground station."""

from __future__ import annotations

import math
import socket
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlsplit
from xml.etree import ElementTree

from dronemon.errors import OptionError
from dronemon.events import AreaLaid, Event, Measured
from dronemon.export.formats import cot_event
from dronemon.export.story import Sighting, coarse_sighting
from dronemon.mission import Mission
from dronemon.vehicle.ground_station import StationMessages

DEFAULT_CELL_M = 1000.0
"""What leaves the machine by network says where only to this, unless a person asks for more."""
_SAID_AGAIN_S = 30.0
"""A ground station is told in words of a target that was out of sight for so long: it may read
them out."""
Pack = Callable[[Sighting, float], Iterator[bytes]]
"""Datagrams about a sighting, and its vehicle time in seconds."""


def cot_pack(mission: Mission, _: AreaLaid) -> Pack:
    """A Cursor-on-Target event of each sighting."""

    def pack(sighting: Sighting, _: float) -> Iterator[bytes]:
        yield ElementTree.tostring(cot_event(mission.name, sighting), "utf-8")

    return pack


def station_pack(laid: AreaLaid, *, has_markers: bool) -> Pack:
    """Words on a target that comes into sight, and if asked a marker on each sighting."""
    messages = StationMessages(laid.system_id)
    seen_s: dict[int, float] = {}

    def pack(sighting: Sighting, time_s: float) -> Iterator[bytes]:
        number, place = sighting.number, sighting.place
        since_s = abs(time_s - seen_s.get(number, -math.inf))
        seen_s[number] = time_s
        if since_s > _SAID_AGAIN_S:
            digits = max(0, 5 - round(math.log10(max(sighting.error_m, 1.0))))  # 1e-5 deg: 1 m
            where = f"{place.latitude_deg:.{digits}f} {place.longitude_deg:.{digits}f}"
            yield messages.text(f"{sighting.target[:20]} {where} +-{sighting.error_m:.0f} m")
        if has_markers:
            yield messages.marker(number, sighting.target, place)

    return pack


class SightingSender:
    """Sends every sighting to `url`, udp://HOST:PORT.

    option: that named it, for errors
    packing: how to make datagrams of sightings once the area is laid
    cell_m: places are told to this many metres; 0: exactly; None: DEFAULT_CELL_M
    """

    def __init__(
        self,
        url: str,
        option: str,
        mission: Mission,
        packing: Callable[[AreaLaid], Pack],
        cell_m: float | None = None,
    ) -> None:
        """Raises OptionError for what is no such address."""
        family, self._address = _resolved(url, option)
        self._url = url
        self._mission = mission
        self._packing = packing
        self._cell_m = DEFAULT_CELL_M if cell_m is None else cell_m
        self._laid: tuple[AreaLaid, Pack] | None = None
        self._num_lost = 0
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._socket.setblocking(False)

    def __enter__(self) -> SightingSender:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    @property
    def where(self) -> str:
        """Where it sends to, and how exactly, in words."""
        told = f"to {self._cell_m:g} m (exactly with --redact 0)" if self._cell_m else "exactly"
        return f"{self._url}, places {told}"

    @property
    def lost(self) -> str:
        """How many messages did not go out."""
        return f"{self._num_lost} messages to {self._url}" if self._num_lost else ""

    def take(self, event: Event) -> None:
        """Send what was seen."""
        match event:
            case AreaLaid():
                self._laid = event, self._packing(event)
            case Measured() if self._laid is not None:
                laid, pack = self._laid
                for number, is_seen in enumerate(event.measurement.seen.tolist()):
                    if is_seen:
                        self._send(pack(self._sighting(event, number, laid), event.time_s))

    def _sighting(self, event: Measured, number: int, laid: AreaLaid) -> Sighting:
        target = self._mission.targets[number]
        score = float(event.score[number])
        sighting = Sighting(
            number=number,
            target=target.name,
            appearance=target.appearance,
            time=datetime.now(UTC),
            place=laid.area.au_to_geo(event.measurement.target_au[number], laid.origin),
            error_m=float(event.error_m[number]),
            score=None if math.isnan(score) else score,
            crop=None,
        )
        return coarse_sighting(sighting, self._cell_m) if self._cell_m else sighting

    def _send(self, datagrams: Iterator[bytes]) -> None:
        for datagram in datagrams:
            try:
                self._socket.sendto(datagram, self._address)
            except OSError:
                self._num_lost += 1


def _resolved(url: str, option: str) -> tuple[socket.AddressFamily, Any]:
    """Family and address, asked for once: no name is looked up in flight. Raises OptionError."""
    try:
        parts = urlsplit(url)
        if parts.scheme == "udp" and parts.hostname and parts.port:
            found = socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_DGRAM)
            family, *_, address = found[0]
            return family, address
    except (ValueError, OSError) as exc:
        raise OptionError(f"{option} {url}: {exc}; give udp://HOST:PORT") from exc
    raise OptionError(f"{option} {url}: give udp://HOST:PORT, such as udp://127.0.0.1:6969")
