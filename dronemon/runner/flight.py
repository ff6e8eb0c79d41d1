"""The mission's story: get ready, take off, patrol, come home, land; whatever fails, come home."""

from __future__ import annotations

import asyncio
import contextlib
import math
from dataclasses import dataclass

import numpy as np

from dronemon.camera import FrameSource
from dronemon.errors import ControlTaken, DronemonError
from dronemon.frames import AreaFrame, GeoPoint, geo_to_ned
from dronemon.mission import MissionFile
from dronemon.mission.checks import battery_problem
from dronemon.planner import Planner
from dronemon.recorder import RunRecorder
from dronemon.runner.homecoming import Homecoming
from dronemon.runner.patrol import Kit, Patrol
from dronemon.runner.preparation import brief, draw_start_and_roadmap, make_belief
from dronemon.runner.report import Reporter
from dronemon.runner.status import Audience, FlightStatus, Interrupted, Interrupts
from dronemon.types import FloatArray
from dronemon.vehicle import VehicleLink
from dronemon.vision import Detector
from dronemon.viz import FlightView

_GROUND_POSES = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightResult:
    """How a flight ended.

    outcome: `completed`, `interrupted`, `battery low`, `pilot` (took over) or `failed`.
    landing_error_m: distance from home, None if it did not take off or did not land.
    patrol: None if it never began. error: what went wrong, also if the drone came home after it.
    """

    outcome: str
    is_landed: bool
    landing_error_m: float | None
    patrol: Patrol | None
    error: DronemonError | None


async def fly(
    file: MissionFile,
    *,
    link: VehicleLink,
    camera: FrameSource,
    detector: Detector,
    planner: Planner,
    priors_au: FloatArray,
    recorder: RunRecorder,
    view: FlightView,
    interrupts: Interrupts,
    audience: Audience,
) -> FlightResult:
    """Fly one mission with a connected vehicle and a camera to open, from ready to disarmed.

    `rehearse` comes first, or what is compiled and loaded in flight will hold up the setpoints.
    priors_au: (N, 2) au known positions of the targets, NaN where unknown.
    Never raises a DronemonError: what went wrong is in the result, after the drone came home.
    """
    flight = _Flight(
        file, link, camera, detector, planner, priors_au, recorder, view, interrupts, audience
    )
    return await flight.run()


class _Flight:
    def __init__(
        self,
        file: MissionFile,
        link: VehicleLink,
        camera: FrameSource,
        detector: Detector,
        planner: Planner,
        priors_au: FloatArray,
        recorder: RunRecorder,
        view: FlightView,
        interrupts: Interrupts,
        audience: Audience,
    ) -> None:
        self._file = file
        self._mission = file.mission
        self._link = link
        self._camera = camera
        self._detector = detector
        self._planner = planner
        self._priors_au = priors_au
        self._recorder = recorder
        self._view = view
        self._interrupts = interrupts
        self._report = Reporter(link, recorder, view, audience)
        self._home = Homecoming(link, self._report, interrupts, self._status)
        self._patrol: Patrol | None = None
        self._has_flown = False

    async def run(self) -> FlightResult:
        async with contextlib.AsyncExitStack() as self._exit:  # closes the camera
            outcome, error = "failed", None
            try:
                outcome = await self._tell_the_story()
            except DronemonError as exc:
                error, self._report.must_go_on = exc, True
                self._report.note("failure", str(exc), level="ERROR")
            finally:
                homecoming = await self._home.come_home()
            self._report.note("outcome", outcome)
        is_landed = not self._link.state.is_armed
        return FlightResult(
            outcome=outcome,
            is_landed=is_landed,
            landing_error_m=self._distance_from_home_m() if self._has_flown and is_landed else None,
            patrol=self._patrol if self._patrol and self._patrol.tally else None,
            error=error or homecoming,
        )

    async def _tell_the_story(self) -> str:
        """Everything up to the way home. -> outcome"""
        try:
            async with self._interrupts.leaving():
                patrol = self._patrol = await self._prepare()
            await self._launch()
        except Interrupted:
            return "interrupted"
        except ControlTaken as exc:
            if exc.by_failsafe or await self._home.wait_for_pilot(exc):
                raise  # too early to go on: come home
            return "pilot"
        return await self._watch_over(patrol)

    # On the ground

    async def _prepare(self) -> Patrol:
        """Wait for the vehicle, lay the area over the ground, brief the planner."""
        mission, link = self._mission, self._link
        self._report.progress(self._status("waiting for the vehicle"))
        await link.wait_ready(mission.vehicle.ready_timeout_s)
        await self._exit.enter_async_context(self._camera)  # its clock is the vehicle's
        frame = await self._lay_area()
        self._check_distance(frame)
        start_au, roadmap = draw_start_and_roadmap(mission)
        briefing = brief(mission, self._priors_au, start_au, stream="planner")
        await asyncio.to_thread(self._planner.reset, briefing, roadmap)
        self._view.area(frame, footprint_radius_m=mission.sensor_radius_m)
        self._view.roadmap(roadmap.nodes_au, np.argwhere(roadmap.edge_lengths_au.toarray() > 0))
        kit = Kit(
            mission=mission,
            frame=frame,
            link=link,
            camera=self._camera,
            detector=self._detector,
            belief=make_belief(mission, self._priors_au),
            planner=self._planner,
            roadmap=roadmap,
            recorder=self._recorder,
            view=self._view,
            interrupts=self._interrupts,
            report=self._report,
        )
        self._report.note("ready", "the vehicle is ready", frame=_describe_frame(frame))
        return Patrol(kit, start_au, yaw_rad=frame.heading_rad)

    async def _lay_area(self) -> AreaFrame:
        """Lay the square over the ground; its height is what the vehicle reads standing on it."""
        area, state = self._mission.area, self._link.state
        assert state.home is not None  # wait_ready waited for both
        assert state.origin is not None
        centre = state.home
        if area.latitude_deg is not None and area.longitude_deg is not None:
            centre = GeoPoint(latitude_deg=area.latitude_deg, longitude_deg=area.longitude_deg)
        north_m, east_m, _ = geo_to_ned(centre, state.origin)
        downs_m = [(await self._link.next_pose()).position_ned_m[2] for _ in range(_GROUND_POSES)]
        return AreaFrame(
            centre_ned_m=(float(north_m), float(east_m)),
            ground_down_m=float(np.mean(downs_m)),
            side_m=area.side_m,
            heading_rad=math.radians(area.heading_deg),
            cruise_speed_m_s=self._mission.flight.cruise_speed_m_s,
        )

    def _check_distance(self, frame: AreaFrame) -> None:
        """Refuse an area that is too far from here for the battery. Raises MissionFileError."""
        away_m = math.dist(self._link.pose.position_ned_m[:2], frame.centre_ned_m)
        if problem := battery_problem(self._mission, away_m):
            raise self._file.error(("area", "latitude_deg"), problem)

    # In the air

    async def _launch(self) -> None:
        """Arm and climb."""
        if self._interrupts.return_home:
            raise Interrupted
        self._home.arm_was_asked = True
        self._report.progress(self._status("arming"))
        await self._link.arm()  # not interruptible: it could arm after nobody waits any more
        self._report.note("armed", "motors are running")
        async with self._interrupts.leaving():
            self._has_flown = True
            self._report.progress(self._status("taking off"))
            await self._link.take_off(self._mission.flight.altitude_m)
        self._report.note("airborne", f"at {self._mission.flight.altitude_m:g} m")

    async def _watch_over(self, patrol: Patrol) -> str:
        """Patrol until it ends; when the pilot takes over, wait until control is given back."""
        outcomes = {"horizon": "completed", "interrupt": "interrupted", "battery": "battery low"}
        while True:
            try:
                return outcomes[await patrol.run()]
            except ControlTaken as exc:
                if exc.by_failsafe:
                    raise
                if not await self._home.wait_for_pilot(exc):
                    return "pilot"

    # Telling

    def _status(self, phase: str) -> FlightStatus:
        if self._patrol is not None:
            return self._patrol.status(phase)
        return FlightStatus(
            phase=phase,
            horizon_au=self._mission.horizon_au,
            battery=self._link.state.battery,
            since_seen_s={target.name: None for target in self._mission.targets},
        )

    def _distance_from_home_m(self) -> float | None:
        state = self._link.state
        if state.home is None or state.origin is None:
            return None
        home = geo_to_ned(state.home, state.origin)
        return math.dist(self._link.pose.position_ned_m[:2], home[:2])


def _describe_frame(frame: AreaFrame) -> dict[str, object]:
    return {
        "centre_ned_m": frame.centre_ned_m,
        "ground_down_m": frame.ground_down_m,
        "side_m": frame.side_m,
        "heading_rad": frame.heading_rad,
        "cruise_speed_m_s": frame.cruise_speed_m_s,
    }
