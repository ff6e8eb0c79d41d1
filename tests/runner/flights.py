"""Flights of the whole runner on a vehicle in memory, open to what a test does."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import virtual_time
from fake_link import FakeCamera, FakeLink

from dronemon.events import Audience, Event, Noted
from dronemon.guard import Reason
from dronemon.mission import load_mission
from dronemon.planner import Briefing, Snapshot, Waypoint
from dronemon.roadmap import Roadmap
from dronemon.runner.flight import FlightResult, fly_mission
from dronemon.runner.history import History
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.preparation import FlightSetup
from dronemon.vehicle import Mode

MISSION = """
name: small
area: {side_m: 100}
flight: {altitude_m: 22, cruise_speed_m_s: 5, horizon_au: 0.8, start_au: [0.5, 0.4]}
targets:
  - {name: Bella, appearance: cow, prior_au: [0.4, 0.6]}
"""
LONGER = MISSION.replace("horizon_au: 0.8", "horizon_au: 4")
FASTER = LONGER.replace("speed_m_s: 5", "speed_m_s: 12")
FLIGHT_LIMIT_S = 3000.0


class Shuttle:
    """Flies to and fro; `answer` may replace its third waypoint."""

    name = "shuttle"

    def __init__(self) -> None:
        self.asked = 0
        self.answer: Callable[[], Waypoint] | None = None
        self.on_reset: Callable[[], object] = lambda: None

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        self.asked = 0
        self.on_reset()

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        self.asked += 1
        snapshot.position_au[:] = np.nan  # its own copy
        if self.asked == 3 and self.answer is not None:
            return self.answer()
        return Waypoint(position_au=np.array([0.5, 0.6 if self.asked % 2 else 0.4]))


class Blind:
    """A detector that finds nothing."""

    def detect(self, *_: object) -> tuple[()]:
        return ()


class Listener:
    """Keeps what it is told; `on_note` may act on it."""

    lost = ""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.on_note: Callable[[str], None] = lambda kind: None

    def take(self, event: Event) -> None:
        self.events.append(event)
        if isinstance(event, Noted):
            self.on_note(event.kind)

    @property
    def kinds(self) -> list[str]:
        return [event.kind for event in self.events if isinstance(event, Noted)]

    def texts(self, words: str) -> int:
        return sum(isinstance(event, Noted) and words in event.text for event in self.events)

    def text(self, kind: str) -> str:
        return next(e.text for e in self.events if isinstance(e, Noted) and e.kind == kind)


class Flight:
    """One flight, its parts open to what a test does to them."""

    def __init__(self, path: Path, reasons: set[Reason]) -> None:
        self.path, self.reasons = path, reasons
        self.record, self.view = Listener(), Listener()
        self.interrupts = Interrupts()
        self.planner = Shuttle()
        self.detector: Any = Blind()
        self.picture_px = (640, 480)
        self.mission_text = MISSION
        self.priors_au = np.array([[0.4, 0.6]])
        self.settings: dict[str, float] = {}
        self.history: History | None = None
        self.on_link: Callable[[FakeLink], None] = lambda link: None

    def fly(self, *faults: str, **options: Any) -> FlightResult:
        return virtual_time.run(asyncio.wait_for(self._fly(faults, options), FLIGHT_LIMIT_S))

    async def _fly(self, faults: tuple[str, ...], options: dict[str, Any]) -> FlightResult:
        self.path.write_text(self.mission_text)
        self.task = asyncio.current_task()
        async with FakeLink(faults=faults, **options) as self.link:
            self.on_link(self.link)
            return await fly_mission(
                FlightSetup(
                    file=load_mission(self.path),
                    link=self.link,
                    camera=FakeCamera(self.link, *self.picture_px),
                    detector=self.detector,
                    planner=self.planner,
                    priors_au=self.priors_au,
                    record=self.record,
                    audience=Audience((self.view,)),
                    interrupts=self.interrupts,
                    settings=self.settings,
                    history=self.history,
                )
            )

    @property
    def commands(self) -> list[str]:
        """Without the hold in which a vehicle of ours is left on the ground."""
        sent = self.link.commands
        return sent[:-1] if sent and sent[-1] == "hold" else sent

    def ask(self, times: int = 1) -> None:
        for _ in range(times):
            self.interrupts.request()

    def when(self, kind: str, act: Callable[[], object]) -> None:
        """Act once, when something of this kind is noted."""

        def hear(noted: str) -> None:
            if noted == kind:
                self.record.on_note = lambda kind: None
                act()

        self.record.on_note = hear

    def later(self, duration_s: float, act: Callable[[], object]) -> None:
        asyncio.get_running_loop().call_later(duration_s, act)


flown: set[int] = set()
"""Numbers of the table's rows that decided something in a flight of this process."""


def comes_home(flight: Flight, result: FlightResult) -> None:
    assert result.is_landed
    assert flight.commands[-1] in {"return", "land", "disarm"}
    assert flight.record.kinds[-2:] == ["disarmed", "outcome"]


def hangs() -> Waypoint:
    virtual_time.let_time_pass()
    threading.Event().wait()
    raise AssertionError


def leaves() -> Waypoint:
    sys.exit(3)


# The pilot
def give_back(flight: Flight) -> None:
    flight.link.vehicle.choose(Mode.OFFBOARD)
