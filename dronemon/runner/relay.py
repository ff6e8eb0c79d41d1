"""From one battery to the next: landed, the program waits for a fresh one, and then flies on."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager

from dronemon.errors import VehicleError
from dronemon.events import EventStream, Level
from dronemon.frames import geo_to_ned
from dronemon.runner.flight import FlightResult
from dronemon.runner.interrupts import Interrupted
from dronemon.runner.preparation import FlightSetup
from dronemon.runner.tally import Tally, progress
from dronemon.vehicle import AIRBORNE, Landed, VehicleLink, VehicleState
from dronemon.vehicle.changes import Changes

REQUEST_FILE = "go-on"
"""In the run folder: a person's word that all are clear of the drone."""
BATTERY, WAITING, CHANGED = "fresh battery", "waiting", "battery changed"
"""Kinds of events: of the wait for one, after which that word is heard, and which ends the wait."""
FRESH_LEVEL = 0.5
_RISE, _MOST = 0.1, 0.95
"""By how much a fresh battery shows more than the one that landed, as long as it can."""
_SAME_PLACE_M = 10.0
"""Within which it is at home, or has not been moved: a place that GPS tells drifts."""
WAIT_LIMIT_S = 3600.0
_STEADY_HEARTBEATS = 5  # what is read while it is plugged in jumps
_LOOK_S = 0.5


class Relay:
    """Decides whether a flight is followed by one with another battery, and waits for that.

    setup:   of the flight that has ended, on whose clock the wait is told
    connect: gives a link to the vehicle, which may have been switched off meanwhile
    """

    def __init__(
        self,
        setup: FlightSetup,
        connect: Callable[[], AbstractAsyncContextManager[VehicleLink]],
    ) -> None:
        self._setup, self._connect = setup, connect
        self._mission = setup.file.mission
        self._events = EventStream(setup.record, setup.audience, setup.link)
        self._events.must_go_on = True  # it is on the ground

    async def goes_on(self, result: FlightResult, landed: FlightResult | None = None) -> bool:
        """Whether the run goes on: the flight lacked nothing but a battery, and a fresh one is in.

        It does not if a person ends the wait, nobody comes within an hour, or the last battery
        brought not even a picture. Other programs are kept from the vehicle meanwhile.

        landed: the last flight of the run, where `result` is of a try after it that did not take
        off; the next one then needs a person's word
        """
        interrupts, is_refused = self._setup.interrupts, landed is not None
        if is_refused and not isinstance(result.error, VehicleError):
            return False
        landed = landed or result
        tally = landed.tally
        if self._mission.flight.relay is None or landed.outcome != "battery low":
            return False
        if tally is None or not landed.is_landed or landed.error or interrupts.count:
            return False
        if len(tally.sightings) == tally.num_before:
            self._note("a battery brings it no further: no picture was taken with this one")
            return False
        self._judge(landed, is_refused=is_refused)
        try:
            with Changes(self._setup.link, self._note) as changes:
                changes.claim()
                async with asyncio.timeout(WAIT_LIMIT_S), interrupts.leaving():
                    await self._see_fresh(tally)
        except (Interrupted, TimeoutError, VehicleError, OSError) as exc:
            why = str(exc) or "a person ended the wait, or nobody came"
            self._note(f"it is not gone on with: {why}", "WARN")
            return False
        self._note("goes on with a fresh one", kind=CHANGED)
        return True

    def _judge(self, landed: FlightResult, *, is_refused: bool) -> None:
        """What a fresh battery shows after this landing, and whether that alone is enough.

        It is not where none can be told from the one that landed, after a landing elsewhere, where
        a pilot had control on the way, nor after a try that was refused. `_look_after` goes on.
        """
        level, away_m = landed.landing_battery, landed.landing_error_m
        self._is_told = level is not None and level + _RISE <= _MOST
        self._least = max(FRESH_LEVEL, level + _RISE if level and self._is_told else 0.0)
        is_at_home = away_m is not None and away_m <= _SAME_PLACE_M
        is_asked_for = self._mission.flight.relay == "confirmed" or is_refused
        is_unclear = not self._is_told or not is_at_home or landed.was_taken_home
        is_place_known = self._setup.link.state.place is not None
        self._needs_word = is_asked_for or is_unclear or not is_place_known

    def _note(self, text: str, level: Level = "INFO", kind: str = BATTERY) -> None:
        self._events.note(kind, text, level=level)

    async def _see_fresh(self, tally: Tally) -> None:
        """Wait until the vehicle, on the ground with its motors off, shows a fresh battery."""
        self._note(
            f"change it: waiting for one of {self._least:.0%} or more"
            f"{', then for `dronemon resume`' if self._needs_word else ''}, for "
            f"{WAIT_LIMIT_S / 60.0:g} min at most; Ctrl-C ends the flight"
        )
        told = ""
        while True:
            try:
                async with self._connect() as link:
                    await self._watch(link, tally)
                return
            except VehicleError as exc:  # as while it is switched off
                if self._setup.interrupts.is_hopeless:
                    raise
                if str(exc) != told:
                    told = str(exc)
                    self._note(f"still waiting: {told}")
            await asyncio.sleep(_LOOK_S)

    async def _watch(self, link: VehicleLink, tally: Tally) -> None:
        """Wait for a fresh battery and, where it is asked for, a person's word while it stays in.

        That word is what `dronemon resume` leaves in the run folder. Raises VehicleError where
        another vehicle answers.
        """
        flown, num_fresh = self._setup.link, 0
        request = self._setup.folder / REQUEST_FILE
        while True:
            await link.next_heartbeat()
            boards = {link.state.hardware, flown.state.hardware} - {None}
            if len(boards) > 1:
                raise VehicleError("another vehicle answers, whose board is not that which landed")
            now_s = flown.time_s + flown.heartbeat_age_s
            was_fresh = num_fresh >= _STEADY_HEARTBEATS
            self._look_after(link.state)
            num_fresh = num_fresh + 1 if self._is_fresh(link.state) else 0
            is_fresh = num_fresh >= _STEADY_HEARTBEATS
            if was_fresh and not is_fresh:
                self._note("it is out again, or not fresh any more: still waiting")
            phase = "waiting for a word" if is_fresh else "waiting for a fresh battery"
            if not self._needs_word and self._moved_m(link.state) is None:
                phase += ", and a good position"
            battery = link.state.battery
            self._events.emit(progress(phase, self._mission, tally, now_s, battery=battery))
            if is_fresh and not self._needs_word:
                return
            if num_fresh == _STEADY_HEARTBEATS:
                request.unlink(missing_ok=True)
                self._ask_for_word(is_seen=self._is_told and battery is not None)
            elif is_fresh and request.exists():
                request.unlink()
                return

    def _ask_for_word(self, *, is_seen: bool) -> None:
        what = "a fresh battery is in" if is_seen else "see to a fresh battery: no level tells one"
        command = f"`dronemon resume {self._setup.folder}`"
        self._note(f"{what}; once all are clear, {command} takes off", kind=WAITING)

    def _look_after(self, state: VehicleState) -> None:
        """Where somebody else flies or moves it meanwhile, a battery alone is not enough any more.

        Places on the globe are compared: the local frame may begin anew with the battery.
        """
        is_flown = state.is_armed or state.landed in AIRBORNE
        moved_m = self._moved_m(state)
        is_moved = moved_m is not None and moved_m > _SAME_PLACE_M
        if (is_flown or is_moved) and not self._needs_word:
            self._needs_word = True
            text = "it was flown or moved meanwhile: it takes off only after `dronemon resume`"
            self._note(text, "WARN")

    def _moved_m(self, state: VehicleState) -> float | None:
        """How far it is from where it landed; None as long as that is not known."""
        landed = self._setup.link.state.place
        if landed is None or state.place is None or not state.is_position_good:
            return None
        return math.hypot(*geo_to_ned(state.place, landed)[:2])

    def _is_fresh(self, state: VehicleState) -> bool:
        """What the vehicle does not tell, a level or its place, is a person's to judge."""
        is_still = state.landed is Landed.ON_GROUND and not state.is_armed
        is_told = state.battery is not None and self._moved_m(state) is not None
        if not is_told and not self._needs_word:
            return False
        return is_still and (state.battery is None or state.battery >= self._least)
