"""The flight as a Rerun recording: to a file, live on loopback, never in the flight's way.

Every call puts one task into a bounded queue and returns; one worker thread turns tasks into Rerun
data. When the queue is full the newest task is dropped and counted. A task that fails is counted
too, and `error` says why the first one did; the flight goes on.
"""

from __future__ import annotations

import contextlib
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType

import numpy as np
import rerun as rr

from dronemon.frames import AreaFrame
from dronemon.types import (
    CameraModel,
    Detection,
    FloatArray,
    IntArray,
    Measurement,
    Picture,
    Pose,
)
from dronemon.viz import entities
from dronemon.viz.file import RecordingFile
from dronemon.viz.page import LivePage
from dronemon.viz.scene import Level, Scene

POSE_INTERVAL_S = 0.2
FLUSH_S, LIVE_FLUSH_S = 2.0, 0.5
"""Data of this wall time are written together: at 1x half a second makes a file twice as large."""
FINISH_S = 5.0
"""Limit on ending the recording once all that was waiting is written."""
Task = Callable[[rr.RecordingStream, Scene], None]


class FlightView:
    """Records one flight, and shows it live if asked to; `with` opens and closes it.

    targets: appearance of each target by name, in the order of all arrays; side_m, heading_rad:
    the area's, for the layout; port: of the live data; max_tasks, max_bytes: what may wait.
    Arrays handed over must not change afterwards.
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
        max_tasks: int = 400,
        max_bytes: int = 64_000_000,
    ) -> None:
        self._rrd_path = rrd_path
        self._file: RecordingFile | None = None
        self._title = title
        self._scene = Scene(targets=targets, camera=camera)
        self._blueprint = entities.blueprint(list(targets), side_m, heading_rad)
        self._port = port if live else None
        self._queue = _BoundedQueue(max_tasks=max_tasks, max_bytes=max_bytes)
        self._page: LivePage | None = None
        self._worker: threading.Thread | None = None
        self._pose_due_s = -np.inf

    @property
    def url(self) -> str | None:
        """Address of the live page; None without one."""
        return self._page.url if self._page else None

    @property
    def dropped(self) -> int:
        """Number of calls whose data were not recorded."""
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
            target=self._queue.work, args=(recording, self._scene), name="viz", daemon=True
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

    def area(self, area: AreaFrame, *, footprint_radius_m: float) -> None:
        """Draw the area; nothing else appears on the map before it is known."""
        self._queue.put(lambda rec, scene: scene.area(rec, area, footprint_radius_m))

    def roadmap(self, nodes_au: FloatArray, edges: IntArray) -> None:
        """Draw the roadmap. nodes_au: (V, 2) au; edges: (E, 2) int node numbers."""
        self._queue.put(lambda rec, scene: scene.roadmap(rec, nodes_au, edges))

    def pose(self, pose: Pose) -> None:
        """Move the vehicle; poses that follow within 0.2 s of vehicle time are passed over."""
        if self._pose_due_s - POSE_INTERVAL_S <= pose.time_s < self._pose_due_s:
            return
        self._pose_due_s = pose.time_s + POSE_INTERVAL_S
        self._queue.put(lambda rec, scene: scene.pose(rec, pose))

    def picture(self, picture: Picture, detections: Sequence[Detection], pose: Pose) -> None:
        """Show a picture, what was found in it, and the footprint's edge as seen from `pose`."""
        self._queue.put(
            lambda rec, scene: scene.picture(rec, picture, detections, pose), picture.image.nbytes
        )

    def measurement(self, time_s: float, measurement: Measurement) -> None:
        """Show where targets were seen last, and for how long they have not been."""
        self._queue.put(lambda rec, scene: scene.measurement(rec, time_s, measurement))

    def beliefs(self, time_s: float, mean: FloatArray, std: FloatArray) -> None:
        """Show the posteriors at the points of `belief_grid_au`. mean, std: (N, G, G)."""
        self._queue.put(
            lambda rec, scene: scene.beliefs(rec, time_s, mean, std), mean.nbytes + std.nbytes
        )

    def waypoint(self, time_s: float, position_au: FloatArray, waypoint_au: FloatArray) -> None:
        """Show the leg to a new waypoint. position_au, waypoint_au: (2,) au."""
        self._queue.put(lambda rec, scene: scene.waypoint(rec, time_s, position_au, waypoint_au))

    def truth(self, time_s: float, position_au: FloatArray) -> None:
        """Show where the simulator has the targets. position_au: (N, 2) au."""
        self._queue.put(lambda rec, scene: scene.truth(rec, time_s, position_au))

    def event(self, time_s: float | None, kind: str, text: str, *, level: Level = "INFO") -> None:
        """Add a line to the log. time_s: None before the vehicle is heard."""
        self._queue.put(lambda rec, scene: scene.event(rec, time_s, f"{kind}: {text}", level))

    def scalars(
        self,
        time_s: float,
        *,
        battery: float | None = None,
        cross_track_m: float | None = None,
        decision_ms: float | None = None,
    ) -> None:
        """Add points to the time series that are given; speed and height come with the pose."""
        given = {"battery": battery, "cross_track_m": cross_track_m, "decision_ms": decision_ms}
        values = {key: value for key, value in given.items() if value is not None}
        self._queue.put(lambda rec, scene: scene.scalars(rec, time_s, values))


class _BoundedQueue:
    """Tasks for one worker thread, limited in number and bytes; counts what it turns away."""

    def __init__(self, *, max_tasks: int, max_bytes: int) -> None:
        self.dropped = 0
        self.error: str | None = None
        self._max_tasks = max_tasks
        self._max_bytes = max_bytes
        self._tasks: deque[tuple[Task, int]] = deque()
        self._waiting_bytes = 0
        self._deadline_s: float | None = None
        self._changed = threading.Condition()

    def put(self, task: Task, num_bytes: int = 0) -> None:
        """Add a task, or drop and count it if the queue is full or closed."""
        with self._changed:
            if (
                self._deadline_s is not None
                or len(self._tasks) >= self._max_tasks
                or self._waiting_bytes + num_bytes > self._max_bytes
            ):
                self.dropped += 1
                return
            self._tasks.append((task, num_bytes))
            self._waiting_bytes += num_bytes
            self._changed.notify()

    def close(self, timeout_s: float) -> None:
        """Let the worker end, at the latest after this time with the task it is at."""
        with self._changed:
            self._deadline_s = time.monotonic() + timeout_s
            self._changed.notify()

    def work(self, rec: rr.RecordingStream, scene: Scene) -> None:
        """Do tasks until closed, then finish the recording; the worker thread's body."""
        rr.set_strict_mode(True)  # errors are raised rather than printed
        scene.start(rec)
        while (task := self._next()) is not None:
            try:
                task(rec, scene)
            except Exception as exc:  # noqa: BLE001  no value may end the recording
                self._count_failure(f"{type(exc).__name__}: {exc}")
        rec.disconnect()

    def _next(self) -> Task | None:
        with self._changed:
            while not self._tasks and self._deadline_s is None:
                self._changed.wait()
            is_late = self._deadline_s is not None and time.monotonic() > self._deadline_s
            if self._tasks and not is_late:
                task, num_bytes = self._tasks.popleft()
                self._waiting_bytes -= num_bytes
                return task
            self.dropped += len(self._tasks)
            self._tasks.clear()
            return None

    def _count_failure(self, reason: str) -> None:
        with self._changed:
            self.dropped += 1
            self.error = self.error or reason
