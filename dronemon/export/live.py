"""Sightings sent while it flies, as Cursor-on-Target events, one datagram each."""

from __future__ import annotations

import math
import socket
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlsplit
from xml.etree import ElementTree

from dronemon.errors import OptionError
from dronemon.events import AreaLaid, Event, Measured
from dronemon.export.formats import cot_event
from dronemon.export.story import Sighting, coarse_sighting
from dronemon.mission import Mission

DEFAULT_CELL_M = 1000.0
"""What leaves the machine by network says where only to this, unless a person asks for more."""


class CotSender:
    """Sends every sighting to `url`, udp://HOST:PORT; `dropped` counts those that did not go out.

    cell_m: places are told to this many metres; 0: exactly; None: DEFAULT_CELL_M
    """

    def __init__(self, url: str, mission: Mission, cell_m: float | None = None) -> None:
        """Raises OptionError for what is no such address."""
        family, self._address = _resolved(url)
        self._mission = mission
        self._cell_m = DEFAULT_CELL_M if cell_m is None else cell_m
        self._laid: AreaLaid | None = None
        self.dropped = 0
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def __enter__(self) -> CotSender:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def take(self, event: Event) -> None:
        """Send what was seen."""
        match event:
            case AreaLaid():
                self._laid = event
            case Measured() if self._laid is not None:
                for number, is_seen in enumerate(event.measurement.seen.tolist()):
                    if is_seen:
                        self._send(self._sighting(event, number, self._laid))

    def _sighting(self, event: Measured, number: int, laid: AreaLaid) -> Sighting:
        target = self._mission.targets[number]
        score = float(event.score[number])
        sighting = Sighting(
            number=number,
            target=target.name,
            appearance=target.appearance,
            time=datetime.now(UTC),
            place=laid.area.au_to_geo(event.measurement.target_au[number], laid.origin),
            error_m=event.error_m,
            score=None if math.isnan(score) else score,
            crop=None,
        )
        return coarse_sighting(sighting, self._cell_m) if self._cell_m else sighting

    def _send(self, sighting: Sighting) -> None:
        try:
            event = ElementTree.tostring(cot_event(self._mission.name, sighting), "utf-8")
            self._socket.sendto(event, self._address)
        except OSError:
            self.dropped += 1


def _resolved(url: str) -> tuple[socket.AddressFamily, Any]:
    """Family and address, asked for once: no name is looked up in flight. Raises OptionError."""
    try:
        parts = urlsplit(url)
        if parts.scheme == "udp" and parts.hostname and parts.port:
            found = socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_DGRAM)
            family, *_, address = found[0]
            return family, address
    except (ValueError, OSError) as exc:
        raise OptionError(f"--cot {url}: {exc}; give udp://HOST:PORT") from exc
    raise OptionError(f"--cot {url}: give udp://HOST:PORT, such as udp://127.0.0.1:6969")
