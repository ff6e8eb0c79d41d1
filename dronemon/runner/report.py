"""Tells record, view and audience what happens; one place, so that all three hear the same."""

from __future__ import annotations

import contextlib

from dronemon.errors import RecordError, VehicleError
from dronemon.recorder import RunRecorder
from dronemon.runner.status import Audience, FlightStatus, Level
from dronemon.vehicle import VehicleLink
from dronemon.viz import FlightView


class Reporter:
    """Reports one flight.

    While `must_go_on`, on the way home or when the pilot flies, a record that cannot be written is
    only counted by the recorder.
    """

    def __init__(
        self, link: VehicleLink, recorder: RunRecorder, view: FlightView, audience: Audience
    ) -> None:
        self._link = link
        self._recorder = recorder
        self._view = view
        self._audience = audience
        self._time_s: float | None = None
        self.must_go_on = False

    def note(self, kind: str, text: str, *, level: Level = "INFO", **fields: object) -> None:
        """Report an event. Raises RecordError if it cannot be recorded."""
        with contextlib.suppress(VehicleError):
            self._time_s = self._link.time_s
        try:
            self._recorder.event(kind, text, time_s=self._time_s, **fields)
        except RecordError:
            if not self.must_go_on:
                raise
        finally:
            self._view.event(self._time_s, kind, text, level=level)
            self._audience.event(kind, text, level)

    def progress(self, status: FlightStatus) -> None:
        """Report progress, and what the autopilot said since the last time."""
        for said in self._link.texts():
            self.note("autopilot", said.text)
        self._audience.status(status)
