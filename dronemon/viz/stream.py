"""The flight as a Rerun recording: to a file, live on loopback, never in the flight's way.

Every event goes into a bounded queue; one worker thread turns events into Rerun data. When the
queue is full the newest one is dropped and counted. One that cannot be drawn is counted too, and
`error` says why the first could not; the flight goes on.
"""

from __future__ import annotations

import contextlib
import threading
import time
import uuid
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

import numpy as np
import rerun as rr

from dronemon.events import Believed, Event, Moved, Pictured, Progressed
from dronemon.types import CameraModel
from dronemon.viz import entities
from dronemon.viz.drawing import Drawing
from dronemon.viz.file import RecordingFile
from dronemon.viz.page import LivePage

POSE_INTERVAL_S = 0.2
FLUSH_S, LIVE_FLUSH_S = 2.0, 0.5
"""Data of this wall time are written together: at 1x half a second makes a file twice as large."""
FINISH_S = 5.0
"""Limit on ending the recording once all that was waiting is written."""


class FlightView:
    """Records one flight, and shows it live if asked to; `with` opens and closes it.

    targets: appearance of each target by name, in the order of all arrays; side_m, heading_rad:
    the area's, for the layout; port: of the live data; max_events, max_bytes: what may wait.
    """

    def __init__(
        self,
        rrd_path: Path,
        *,
        title: str,
        targets: Mapping[str, str],
        camera: CameraModel,
        side_m: float,
        heading_rad: float = 0.0,
        live: bool = False,
        port: int = 9876,
        max_events: int = 400,
        max_bytes: int = 64_000_000,
    ) -> None:
        self._rrd_path = rrd_path
        self._file: RecordingFile | None = None
        self._title = title
        self._drawing = Drawing(targets=targets, camera=camera)
        self._blueprint = entities.blueprint(list(targets), side_m, heading_rad)
        self._port = port if live else None
        self._queue = _BoundedQueue(max_events=max_events, max_bytes=max_bytes)
        self._page: LivePage | None = None
        self._worker: threading.Thread | None = None
        self._pose_due_s = -np.inf

    @property
    def url(self) -> str | None:
        """Address of the live page; None without one."""
        return self._page.url if self._page else None

    @property
    def dropped(self) -> int:
        """Number of events that were not recorded."""
        return self._queue.dropped

    @property
    def error(self) -> str | None:
        """What went wrong, if anything did: recording or page then lack something."""
        parts = (self._file, self._queue, self._page)
        return next((part.error for part in parts if part is not None and part.error), None)

    def __enter__(self) -> FlightView:
        """Open the file and, live, the page. Raises ViewError if one of them cannot be."""
        recording = rr.RecordingStream(
            "dronemon",
            recording_id=str(uuid.uuid4()),
            batcher_config=rr.ChunkBatcherConfig(
                flush_tick=FLUSH_S if self._port is None else LIVE_FLUSH_S
            ),
        )
        recording.set_log_time_enabled(False)
        with contextlib.ExitStack() as undo:
            if self._port is not None:
                self._page = LivePage(self._port)
                undo.callback(self._page.close)
            self._file = RecordingFile(self._rrd_path, self._page)
            undo.pop_all()
        recording.set_sinks(self._file.sink(), default_blueprint=self._blueprint)
        self._file.handed_over()
        recording.send_recording_name(self._title)
        self._worker = threading.Thread(
            target=self._queue.work, args=(recording, self._drawing), name="viz", daemon=True
        )
        self._worker.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self, timeout_s: float = 10.0) -> None:
        """Finish the recording and end the page; what is not written by then is dropped."""
        self._queue.close(timeout_s)
        if self._worker is not None:
            self._worker.join(timeout_s + FINISH_S)
        if self._file is not None:
            self._file.wait(FINISH_S)
        if self._page is not None:
            self._page.close()

    def take(self, event: Event) -> None:
        """Show an event; poses that follow within 0.2 s of vehicle time are passed over."""
        num_bytes = 0
        match event:
            case Progressed():
                return
            case Moved(pose=pose):
                if self._pose_due_s - POSE_INTERVAL_S <= pose.time_s < self._pose_due_s:
                    return
                self._pose_due_s = pose.time_s + POSE_INTERVAL_S
            case Pictured():
                num_bytes = event.picture.image.nbytes
            case Believed():
                num_bytes = event.mean.nbytes + event.std.nbytes
        self._queue.put(event, num_bytes)


class _BoundedQueue:
    """Events for one worker thread, limited in number and bytes; counts what it turns away."""

    def __init__(self, *, max_events: int, max_bytes: int) -> None:
        self.dropped = 0
        self.error: str | None = None
        self._max_events = max_events
        self._max_bytes = max_bytes
        self._events: deque[tuple[Event, int]] = deque()
        self._waiting_bytes = 0
        self._deadline_s: float | None = None
        self._changed = threading.Condition()

    def put(self, event: Event, num_bytes: int = 0) -> None:
        """Add an event, or drop and count it if the queue is full or closed."""
        with self._changed:
            if (
                self._deadline_s is not None
                or len(self._events) >= self._max_events
                or self._waiting_bytes + num_bytes > self._max_bytes
            ):
                self.dropped += 1
                return
            self._events.append((event, num_bytes))
            self._waiting_bytes += num_bytes
            self._changed.notify()

    def close(self, timeout_s: float) -> None:
        """Let the worker end, at the latest after this time with the event it is at."""
        with self._changed:
            self._deadline_s = time.monotonic() + timeout_s
            self._changed.notify()

    def work(self, rec: rr.RecordingStream, drawing: Drawing) -> None:
        """Draw events until closed, then finish the recording; the worker thread's body."""
        rr.set_strict_mode(True)  # errors are raised rather than printed
        drawing.start(rec)
        while (event := self._next()) is not None:
            try:
                drawing.draw(rec, event)
            except Exception as exc:  # noqa: BLE001  no value may end the recording
                self._count_failure(f"{type(exc).__name__}: {exc}")
        rec.disconnect()

    def _next(self) -> Event | None:
        with self._changed:
            while not self._events and self._deadline_s is None:
                self._changed.wait()
            is_late = self._deadline_s is not None and time.monotonic() > self._deadline_s
            if self._events and not is_late:
                event, num_bytes = self._events.popleft()
                self._waiting_bytes -= num_bytes
                return event
            self.dropped += len(self._events)
            self._events.clear()
            return None

    def _count_failure(self, reason: str) -> None:
        with self._changed:
            self.dropped += 1
            self.error = self.error or reason
