"""The flight as a Rerun recording: to a file, live on loopback, never in the flight's way.

Every event goes into a bounded queue; one worker thread turns events into Rerun data. When the
queue is full the newest one is dropped and counted. One that cannot be drawn is counted too; `lost`
says how many and why, and the flight goes on.
"""

from __future__ import annotations

import contextlib
import threading
import uuid
from pathlib import Path

import numpy as np
import rerun as rr

from dronemon.events import Attended, Event, Moved, Pictured, Progressed
from dronemon.mission import Mission
from dronemon.viz.drawing import Drawing
from dronemon.viz.entities import blueprint
from dronemon.viz.file import RecordingFile
from dronemon.viz.furniture import LEGEND_SHARE
from dronemon.viz.page import LivePage, Viewer, find_viewer
from dronemon.waiting import BoundedQueue

POSE_INTERVAL_S, POSE_INTERVAL_WALL_S = 0.2, 0.05
"""Poses nearer to each other are passed over: at fifteen times real time they took a fifth of a
core, and decisions waited for it."""
FLUSH_S, LIVE_FLUSH_S, FLUSH_BYTES = 30.0, 0.5, 8_000_000
"""Data of this wall time are written together, and of a flight that nobody watches so many: Rerun
keeps some 4 KB of memory for each entity of each piece, and small pieces make a larger file."""
FINISH_S = 5.0
"""Limit on ending the recording once all that was waiting is written."""


class FlightView:
    """Records one flight, and shows it live if asked to; `with` opens and closes it.

    max_events, max_bytes: what may wait
    """

    def __init__(
        self,
        rrd_path: Path,
        mission: Mission,
        *,
        max_events: int = 400,
        max_bytes: int = 64_000_000,
    ) -> None:
        self._rrd_path = rrd_path
        self._mission = mission
        self._queue = BoundedQueue[Event](max_items=max_events, max_bytes=max_bytes)
        self._num_failed = 0
        self._failure: str | None = None
        self._viewer: Viewer | None = None
        self._page: LivePage | None = None
        speed_up = mission.vehicle.speed_up if mission.vehicle.is_mock else 1.0
        self._pose_interval_s = max(POSE_INTERVAL_S, POSE_INTERVAL_WALL_S * speed_up)
        self._pose_due_s = -np.inf

    @property
    def where(self) -> str | None:
        """Where to look while it flies, in words; None where nothing is shown."""
        return self._viewer.where if self._viewer else None

    @property
    def lost(self) -> str:
        """What the recording or the page lacks, and why."""
        dropped = self._queue.dropped
        whys = (
            self._file.error,
            self._page.error if self._page else None,
            f"{self._num_failed} events that could not be drawn ({self._failure})"
            if self._failure
            else None,
            f"{dropped} events that the recording had no time for" if dropped else None,
        )
        return "; ".join(why for why in whys if why)

    def __enter__(self) -> FlightView:
        """Open the file and, live, the page. Raises ViewError if one of them cannot be."""
        mission, is_live = self._mission, self._mission.view.live
        recording = rr.RecordingStream(
            "dronemon",
            recording_id=str(uuid.uuid4()),
            batcher_config=rr.ChunkBatcherConfig(flush_tick=LIVE_FLUSH_S)
            if is_live
            else rr.ChunkBatcherConfig(flush_tick=FLUSH_S, flush_num_bytes=FLUSH_BYTES),
        )
        recording.set_log_time_enabled(False)
        with contextlib.ExitStack() as undo:
            if is_live:
                self._viewer = find_viewer(mission.view.port)
                self._page = LivePage(self._viewer)
                undo.callback(self._page.close)
            self._file = RecordingFile(self._rrd_path, self._page)
            undo.pop_all()
        self._file.take(recording, blueprint(mission, LEGEND_SHARE * mission.area.side_m))
        recording.send_recording_name(mission.name)
        self._drawing = Drawing(recording, mission)
        self._worker = threading.Thread(
            target=self._work, args=(recording,), name="viz", daemon=True
        )
        self._worker.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def catch_up(self, timeout_s: float) -> None:
        """Wait until what it was told is drawn, at the latest for this time; not in flight."""
        self._queue.wait_empty(timeout_s)

    def close(self, timeout_s: float = 10.0) -> None:
        """Finish the recording and end the page; what is not written by then is dropped."""
        self._queue.close(timeout_s)
        self._worker.join(timeout_s + FINISH_S)
        self._file.wait(FINISH_S)
        if self._page is not None:
            self._page.close()

    def take(self, event: Event) -> None:
        """Show an event; most poses are passed over."""
        num_bytes = 0
        match event:
            case Progressed():
                return
            case Moved(pose=pose):
                if self._pose_due_s - self._pose_interval_s <= pose.time_s < self._pose_due_s:
                    return
                self._pose_due_s = pose.time_s + self._pose_interval_s
            case Pictured():
                num_bytes = event.picture.image.nbytes
            case Attended():
                num_bytes = sum(array.nbytes for array in event.weights.values())
        self._queue.put(event, num_bytes)

    def _work(self, recording: rr.RecordingStream) -> None:
        """Draw events until closed, then finish the recording; the worker thread's body."""
        rr.set_strict_mode(True)  # errors are raised rather than printed
        try:
            self._drawing.start()
            for event in self._queue:
                self._draw(event)
        finally:
            recording.disconnect()

    def _draw(self, event: Event) -> None:
        try:
            self._drawing.draw(event)
        except Exception as exc:  # noqa: BLE001  no value may end the recording
            self._num_failed += 1
            self._failure = self._failure or f"{type(exc).__name__}: {exc}"
