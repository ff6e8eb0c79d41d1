"""The patrol: fly from waypoint to waypoint, take a picture every 0.1 au, believe, choose, go on.

Three tasks share it. `_guide` answers every pose with a setpoint, and says when a picture or a
waypoint is due; `_photograph` takes the picture at that moment; `_watch` looks at pictures and asks
the planner, one after the other, in threads.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from dronemon.belief import Belief
from dronemon.camera import FrameSource
from dronemon.errors import PlannerError, VehicleError
from dronemon.frames import AreaFrame
from dronemon.guidance import Carrot
from dronemon.mission import Mission
from dronemon.planner import Planner, Snapshot
from dronemon.problem import MEASUREMENT_INTERVAL_AU
from dronemon.recorder import RunRecorder
from dronemon.roadmap import Roadmap
from dronemon.runner.daemon import in_daemon_thread
from dronemon.runner.report import Reporter
from dronemon.runner.status import REPORT_INTERVAL_S, FlightStatus, Interrupts
from dronemon.types import FloatArray, Measurement, Picture, Pose
from dronemon.vehicle import Setpoint, VehicleLink
from dronemon.vision import Detector, interpolate_pose, observe
from dronemon.viz import FlightView, belief_grid_au

SETPOINT_INTERVAL_S = 0.05
"""Vehicle time between setpoints: 20 Hz, far from the 2 Hz that PX4 needs."""
STALL_LIMIT_S = 4.0
"""Vehicle time without a new waypoint after which the mission loop counts as hung."""
_MAX_PENDING = 4


@dataclass(kw_only=True)
class Tally:
    """What a patrol has done so far, also across a pause."""

    start_s: float
    flown_m: float = 0.0
    duration_s: float = 0.0
    measurements: list[Measurement] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    last_seen_s: dict[str, float] = field(default_factory=dict)
    num_pictures_due: int = 0
    progress: list[tuple[float, float]] = field(default_factory=list)
    """Vehicle time and distance flown at each setpoint."""
    decision_ms: list[float] = field(default_factory=list)
    cross_track_m: list[float] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Kit:
    """Everything a patrol works with."""

    mission: Mission
    frame: AreaFrame
    link: VehicleLink
    camera: FrameSource
    detector: Detector
    belief: Belief
    planner: Planner
    roadmap: Roadmap
    recorder: RunRecorder
    view: FlightView
    interrupts: Interrupts
    report: Reporter


class Patrol:
    """Flies until the horizon, an interrupt or a low battery; `run` goes on after a pause."""

    def __init__(self, kit: Kit, start_au: FloatArray, yaw_rad: float) -> None:
        self._kit = kit
        self._start_au = start_au
        self._yaw_rad = yaw_rad
        self._down_m = kit.frame.ground_down_m - kit.mission.flight.altitude_m
        self._side_m = kit.frame.side_m
        self._waypoint_au = start_au
        self._node: int | None = 0
        self._new: list[Measurement] = []
        self._last_pose: Pose | None = None
        self._last_setpoint_s = -math.inf
        self._report_due_s = -math.inf
        self._waiting_since_s: float | None = None
        self._is_waypoint_asked = False
        self._grid_au = belief_grid_au()
        self.tally: Tally | None = None

    async def run(self) -> str:
        """Patrol from wherever the vehicle is. -> why it ended: horizon, interrupt or battery.

        Raises what the vehicle, the camera, the planner or the recorder raise.
        """
        flight = self._kit.mission.flight
        pose = self._kit.link.pose
        self._carrot = Carrot(
            pose.position_ned_m[:2],
            speed_m_s=flight.cruise_speed_m_s,
            max_acceleration_m_s2=flight.max_acceleration_m_s2,
        )
        self._carrot.extend(_point(self._kit.frame.au_to_ned(self._waypoint_au)))
        self._last_pose, self._waiting_since_s = None, None
        self._is_waypoint_asked = False
        self._work: asyncio.Queue[Picture | None] = asyncio.Queue(_MAX_PENDING)
        self._picture_due = asyncio.Event()
        await self._kit.link.start_offboard(self._setpoint(pose.position_ned_m[:2], (0.0, 0.0)))
        try:
            async with asyncio.TaskGroup() as group:
                others = [
                    group.create_task(self._photograph(), name="photograph"),
                    group.create_task(self._watch(), name="watch"),
                ]
                reason = await self._guide()
                for task in others:
                    task.cancel()
        except BaseExceptionGroup as group_error:
            # The first failure cancelled the others: it alone is the story.
            raise group_error.exceptions[0] from None
        return reason

    # Guidance

    async def _guide(self) -> str:
        while True:
            pose = await self._kit.link.next_pose()
            self._measure_progress(pose)
            self._kit.view.pose(pose)
            if reason := self._reason_to_end():
                return reason
            duration_s = pose.time_s - self._last_setpoint_s
            if duration_s < SETPOINT_INTERVAL_S:
                continue
            self._last_setpoint_s = pose.time_s
            position_m, velocity_m_s = self._carrot.advance(
                min(duration_s, 4 * SETPOINT_INTERVAL_S), pose.position_ned_m[:2]
            )
            await self._kit.link.send_setpoint(self._setpoint(position_m, velocity_m_s))
            self._ask_for_waypoint(pose)
            self._ask_for_picture(pose)
            self._report(pose)

    def _setpoint(
        self, position_m: tuple[float, float], velocity_m_s: tuple[float, float]
    ) -> Setpoint:
        return Setpoint(
            position_ned_m=(*position_m, self._down_m),
            velocity_ned_m_s=(*velocity_m_s, 0.0),
            yaw_rad=self._yaw_rad,
        )

    def _measure_progress(self, pose: Pose) -> None:
        last, self._last_pose = self._last_pose, pose
        if last is None or self.tally is None:
            return
        duration_s = pose.time_s - last.time_s
        self.tally.flown_m += _ground_speed(pose) * duration_s
        self.tally.duration_s += duration_s

    def _reason_to_end(self) -> str | None:
        """Why the patrol is over, if it is. Raises VehicleError if it cannot go on."""
        mission, state = self._kit.mission, self._kit.link.state
        battery = state.battery
        if not state.is_armed:
            raise VehicleError("the vehicle disarmed during the patrol; see what it says")
        if not state.is_position_good:
            raise VehicleError(
                "the vehicle lost its absolute position (GPS?): where it is, and what it sees "
                "where, cannot be trusted; it comes down"
            )
        if self._kit.interrupts.return_home:
            return "interrupt"
        if battery is not None and battery <= mission.flight.return_battery:
            return "battery"
        if self.tally and self.tally.flown_m >= mission.horizon_au * self._side_m:
            return "horizon"
        return None

    def _ask_for_waypoint(self, pose: Pose) -> None:
        if not self._carrot.needs_waypoint:
            self._is_waypoint_asked, self._waiting_since_s = False, None
            return
        if self._waiting_since_s is None:
            self._waiting_since_s = pose.time_s
        if pose.time_s > self._waiting_since_s + STALL_LIMIT_S:
            raise PlannerError(
                f"no waypoint from planner '{self._kit.planner.name}' for {STALL_LIMIT_S:g} s of "
                "vehicle time after it was due; the drone returns"
            )
        if not self._is_waypoint_asked and not self._work.full():
            self._is_waypoint_asked = True
            self._work.put_nowait(None)

    def _ask_for_picture(self, pose: Pose) -> None:
        if self.tally is None:
            return
        self.tally.progress.append((pose.time_s, self.tally.flown_m))
        interval_m = MEASUREMENT_INTERVAL_AU * self._side_m
        due_m = (self.tally.num_pictures_due + 1) * interval_m
        # The nearest setpoint to the due distance is at most half a setpoint's way off.
        if self.tally.flown_m + 0.5 * SETPOINT_INTERVAL_S * _ground_speed(pose) >= due_m:
            self.tally.num_pictures_due += 1
            self._picture_due.set()
        self.tally.cross_track_m.append(self._carrot.cross_track_m(pose.position_ned_m[:2]))

    # Pictures

    async def _photograph(self) -> None:
        while True:
            await self._picture_due.wait()
            self._picture_due.clear()
            await self._work.put(await self._kit.camera.capture())

    # What is seen, believed and chosen

    async def _watch(self) -> None:
        while True:
            work = await self._work.get()
            if work is None:
                await self._choose()
            else:
                await self._look(work)

    async def _look(self, picture: Picture) -> None:
        tally = self.tally
        assert tally is not None  # pictures are asked for only once the patrol has begun
        before, after = await self._kit.link.poses_around(picture.time_s)
        pose = interpolate_pose(before, after, picture.time_s)
        detections = await asyncio.to_thread(
            self._kit.detector.detect, picture.image, pose, self._kit.frame.ground_down_m
        )
        measurement = observe(
            detections,
            pose=pose,
            camera=self._kit.mission.camera.model,
            frame=self._kit.frame,
            appearances=[target.appearance for target in self._kit.mission.targets],
            time_au=self._kit.frame.s_to_au(picture.time_s - tally.start_s),
        )
        best = {d.appearance: d.score for d in sorted(detections, key=lambda d: d.score)}
        scores = np.array([best.get(t.appearance, np.nan) for t in self._kit.mission.targets])
        self._kit.recorder.observation(
            time_s=picture.time_s,
            measurement=measurement,
            score=np.where(measurement.seen, scores, np.nan),
        )
        tally.measurements.append(measurement)
        tally.times_s.append(picture.time_s)
        for target, is_seen in zip(self._kit.mission.targets, measurement.seen, strict=True):
            if is_seen:
                tally.last_seen_s[target.name] = picture.time_s
        self._new.append(measurement)
        self._kit.belief.add(measurement)
        if self._kit.mission.record.pictures:
            self._kit.view.picture(picture, detections, pose)
        self._kit.view.measurement(picture.time_s, measurement)
        self._kit.view.scalars(
            picture.time_s,
            battery=self._kit.link.state.battery,
            cross_track_m=tally.cross_track_m[-1] if tally.cross_track_m else None,
        )
        await self._show_beliefs(picture.time_s, measurement.time_au)

    async def _show_beliefs(self, time_s: float, time_au: float) -> None:
        rows, columns, _ = self._grid_au.shape
        query = np.concatenate(
            [self._grid_au.reshape(-1, 2), np.full((rows * columns, 1), time_au)], axis=-1
        )
        mean, std = await asyncio.to_thread(self._kit.belief.posterior, query)
        shape = (-1, rows, columns)
        self._kit.view.beliefs(time_s, mean.reshape(shape), std.reshape(shape))

    async def _choose(self) -> None:
        now_s = self._kit.link.time_s
        if self.tally is None:
            self.tally = Tally(start_s=now_s)
            self._kit.report.note("patrol", "the patrol begins")
        flown_au = self.tally.flown_m / self._side_m
        # Asked a little before the waypoint is reached, so that the drone need not stop there.
        ahead_au = max(self._carrot.remaining_m, 0.0) / self._side_m
        snapshot = Snapshot(
            time_au=self._kit.frame.s_to_au(now_s - self.tally.start_s) + ahead_au,
            position_au=self._waypoint_au,
            node=self._node,
            measurements=tuple(self._new),
            belief=self._kit.belief,
            roadmap=self._kit.roadmap,
            remaining_au=max(self._kit.mission.horizon_au - flown_au - ahead_au, 0.0),
        )
        self._new.clear()
        began = time.perf_counter()
        try:
            waypoint = await in_daemon_thread(partial(self._kit.planner.next_waypoint, snapshot))
        except Exception as exc:
            raise PlannerError(
                f"planner '{self._kit.planner.name}' failed: {exc!r}; the drone returns"
            ) from exc
        decision_ms = (time.perf_counter() - began) * 1e3
        if not np.isfinite(waypoint.position_au).all():
            raise PlannerError(
                f"planner '{self._kit.planner.name}' gave waypoint {waypoint.position_au}, "
                "which is no place; the drone returns"
            )
        waypoint_au = np.clip(waypoint.position_au, 0.0, 1.0)
        self._kit.recorder.decision(
            time_s=now_s,
            time_au=snapshot.time_au,
            position_au=snapshot.position_au,
            waypoint_au=waypoint_au,
            node=waypoint.node,
            decision_ms=decision_ms,
            details=waypoint.details,
        )
        self.tally.decision_ms.append(decision_ms)
        self._kit.view.waypoint(now_s, snapshot.position_au, waypoint_au)
        self._kit.view.scalars(now_s, decision_ms=decision_ms)
        self._carrot.extend(_point(self._kit.frame.au_to_ned(waypoint_au)))
        self._waypoint_au, self._node = waypoint_au, waypoint.node
        self._is_waypoint_asked = False

    def _report(self, pose: Pose) -> None:
        if pose.time_s >= self._report_due_s:
            self._report_due_s = pose.time_s + REPORT_INTERVAL_S
            phase = "patrol" if self.tally else "to the start"
            self._kit.report.progress(self.status(phase))

    def status(self, phase: str) -> FlightStatus:
        """How far the patrol is, as a line of progress of any phase."""
        horizon_au, pose = self._kit.mission.horizon_au, self._kit.link.pose
        flown_au = self.tally.flown_m / self._side_m if self.tally else 0.0
        return FlightStatus(
            phase=phase,
            flown_au=flown_au,
            horizon_au=horizon_au,
            left_s=self._kit.frame.au_to_s(max(horizon_au - flown_au, 0.0)),
            speed_m_s=_ground_speed(pose),
            battery=self._kit.link.state.battery,
            since_seen_s=self._since_seen_s(pose.time_s),
        )

    def _since_seen_s(self, now_s: float) -> Mapping[str, float | None]:
        last_s = self.tally.last_seen_s if self.tally else {}
        names = [target.name for target in self._kit.mission.targets]
        return {name: now_s - last_s[name] if name in last_s else None for name in names}


def _point(north_east_m: FloatArray) -> tuple[float, float]:
    return float(north_east_m[0]), float(north_east_m[1])


def _ground_speed(pose: Pose) -> float:
    return math.hypot(*pose.velocity_ned_m_s[:2])
