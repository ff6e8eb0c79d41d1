"""The mission's story: get ready, take off, patrol, come home, land; whatever fails, come home."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from dronemon.belief import Belief, Matern32
from dronemon.camera import FrameSource
from dronemon.errors import (
    CommandRejected,
    CommandUnconfirmed,
    ControlTaken,
    DronemonError,
    LinkLost,
    MissionFileError,
    RecordError,
    VehicleError,
)
from dronemon.frames import AreaFrame, GeoPoint, geo_to_ned
from dronemon.mission import Mission
from dronemon.mission.load import outbound_min, usable_min
from dronemon.planner import Briefing, Planner
from dronemon.recorder import RunRecorder
from dronemon.roadmap import Roadmap
from dronemon.runner.patrol import REPORT_INTERVAL_S, Kit, Patrol
from dronemon.runner.status import Audience, FlightStatus, Interrupts, Level
from dronemon.types import FloatArray
from dronemon.vehicle import Landed, Mode, Setpoint, VehicleLink
from dronemon.vision import Detector
from dronemon.viz import FlightView
from dronemon.world import Instance
from dronemon.world.instance import named_stream

LANDING_LIMIT_S = 900.0
"""Vehicle time for the way home and the landing."""
LOST_LINK_LIMIT_S = 120.0
"""Wall time for a lost link to come back on the way home; the autopilot flies home by itself."""
_GROUND_POSES = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightResult:
    """How a flight ended.

    outcome: `completed`, `interrupted`, `battery low`, `pilot` (took over and landed) or `failed`.
    patrol: None if it never began. error: what went wrong, also if the drone came home after it.
    """

    outcome: str
    is_landed: bool
    landing_error_m: float | None
    patrol: Patrol | None
    error: DronemonError | None


class _Interrupted(Exception):
    """A person stopped the flight before the patrol."""


async def fly(
    mission: Mission,
    *,
    link: VehicleLink,
    camera: FrameSource,
    planner: Planner,
    priors_au: FloatArray,
    recorder: RunRecorder,
    view: FlightView,
    interrupts: Interrupts,
    audience: Audience,
) -> FlightResult:
    """Fly one mission with a connected vehicle and a camera to open, from ready to disarmed.

    priors_au: (N, 2) au known positions of the targets, NaN where unknown.
    Never raises a DronemonError: what went wrong is in the result, after the drone came home.
    """
    torch.set_num_threads(1)
    flight = _Flight(
        mission, link, camera, planner, priors_au, recorder, view, interrupts, audience
    )
    return await flight.run()


class _Flight:
    def __init__(
        self,
        mission: Mission,
        link: VehicleLink,
        camera: FrameSource,
        planner: Planner,
        priors_au: FloatArray,
        recorder: RunRecorder,
        view: FlightView,
        interrupts: Interrupts,
        audience: Audience,
    ) -> None:
        self._mission = mission
        self._link = link
        self._camera = camera
        self._planner = planner
        self._priors_au = priors_au
        self._recorder = recorder
        self._view = view
        self._interrupts = interrupts
        self._audience = audience
        self._patrol: Patrol | None = None
        self._pilot_flies = False
        self._is_coming_home = False
        self._exit = contextlib.AsyncExitStack()
        self._time_s: float | None = None

    async def run(self) -> FlightResult:
        async with self._exit:  # closes the camera
            return await self._fly()

    async def _fly(self) -> FlightResult:
        outcome, error = "failed", None
        try:
            outcome = await self._tell_the_story()
        except DronemonError as exc:
            error, self._is_coming_home = exc, True
            self._note("failure", str(exc), level="ERROR")
        finally:
            self._is_coming_home = True
            homecoming = await self._come_home()
        self._note("outcome", outcome)
        return FlightResult(
            outcome=outcome,
            is_landed=not self._link.state.is_armed,
            landing_error_m=self._distance_from_home_m(),
            patrol=self._patrol if self._patrol and self._patrol.tally else None,
            error=error or homecoming,
        )

    async def _tell_the_story(self) -> str:
        """Everything up to the way home. -> outcome"""
        try:
            async with self._interruptible():
                self._patrol = await self._prepare()
                await self._launch()
        except _Interrupted:
            return "interrupted"
        except ControlTaken as exc:
            if await self._is_given_back(exc):
                raise  # too early to go on: come home
            return "pilot"
        return await self._watch_over(self._patrol)

    @contextlib.asynccontextmanager
    async def _interruptible(self) -> AsyncIterator[None]:
        """Leave the body at the first interrupt. Raises _Interrupted then."""
        if self._interrupts.return_home:
            raise _Interrupted
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(None) as scope:
                self._interrupts.on_request = lambda: scope.reschedule(loop.time())
                yield
        except TimeoutError as exc:
            if scope.expired():
                raise _Interrupted from exc
            raise
        finally:
            self._interrupts.on_request = None

    # On the ground

    async def _prepare(self) -> Patrol:
        """Wait for the vehicle, lay the area over the ground, brief the planner."""
        mission, link = self._mission, self._link
        self._status("waiting for the vehicle")
        await link.wait_ready(mission.vehicle.ready_timeout_s)
        await self._exit.enter_async_context(self._camera)  # its clock is the vehicle's
        frame = await self._lay_area()
        self._check_distance(frame)
        start_au, roadmap = self._draw_start_and_roadmap()
        belief = Belief(len(mission.targets), mission_kernel(mission))
        for index, prior_au in enumerate(self._priors_au):
            if np.isfinite(prior_au).all():
                belief.add_prior(index, prior_au)
        briefing = Briefing(
            num_targets=len(mission.targets),
            priors_au=self._priors_au,
            start_au=start_au,
            horizon_au=mission.horizon_au,
            rng=named_stream(mission.simulation.seed, "planner"),
        )
        await asyncio.to_thread(self._planner.reset, briefing, roadmap)
        detector = Detector(
            [target.appearance for target in mission.targets],
            mission.camera.model,
            mission.detector.min_score,
        )
        self._view.area(frame, footprint_radius_m=mission.sensor_radius_m)
        self._view.roadmap(roadmap.nodes_au, np.argwhere(roadmap.edge_lengths_au.toarray() > 0))
        kit = Kit(
            mission=mission,
            frame=frame,
            link=link,
            camera=self._camera,
            detector=detector,
            belief=belief,
            planner=self._planner,
            roadmap=roadmap,
            recorder=self._recorder,
            view=self._view,
            interrupts=self._interrupts,
            audience=self._audience,
        )
        self._note("ready", "the vehicle is ready", frame=_describe_frame(frame))
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
        here = self._link.pose.position_ned_m
        away_m = math.dist(here[:2], frame.centre_ned_m)
        speed_m_s = self._mission.flight.cruise_speed_m_s
        minutes = outbound_min(self._mission) + away_m / speed_m_s / 60.0
        if minutes > usable_min(self._mission):
            raise MissionFileError(
                f"area: its centre is {away_m:.0f} m from the vehicle; the flight until the return "
                f"would take {minutes:.1f} min, the battery allows "
                f"{usable_min(self._mission):.1f} min; check latitude_deg and longitude_deg, or "
                "bring the vehicle nearer"
            )

    def _draw_start_and_roadmap(self) -> tuple[FloatArray, Roadmap]:
        seed, mission = self._mission.simulation.seed, self._mission
        start_au = (
            np.array(mission.flight.start_au)
            if mission.flight.start_au is not None
            else Instance.draw(seed, len(mission.targets)).start_au
        )
        roadmap = Roadmap.random(
            mission.roadmap.num_nodes,
            mission.roadmap.num_neighbours,
            named_stream(seed, "roadmap"),
            start_au,
        )
        return start_au, roadmap

    # In the air

    async def _launch(self) -> None:
        """Arm and climb."""
        self._status("arming")
        await self._link.arm()
        self._note("armed", "motors are running")
        self._status("taking off")
        await self._link.take_off(self._mission.flight.altitude_m)
        self._note("airborne", f"at {self._mission.flight.altitude_m:g} m")

    async def _watch_over(self, patrol: Patrol) -> str:
        """Patrol until it ends; when the pilot takes over, wait until control is given back."""
        outcomes = {"horizon": "completed", "interrupt": "interrupted", "battery": "battery low"}
        while True:
            try:
                return outcomes[await patrol.run()]
            except ControlTaken as exc:
                if not await self._is_given_back(exc):
                    return "pilot"
                self._note("control given back", "offboard again")

    async def _is_given_back(self, taken: ControlTaken) -> bool:
        """Wait for the pilot: True once the mode is offboard again, False once disarmed.

        A setpoint for the present place flows meanwhile, since PX4 lets the pilot choose offboard
        only then. It does not flow during a failsafe, which it would end.
        """
        self._note("control taken", str(taken), level="WARN")
        link = self._link
        link.release()
        self._status("the pilot flies")
        while link.state.is_armed and not self._interrupts.land_now:
            pose = await link.next_pose()
            if link.state.mode is Mode.OFFBOARD:
                return True
            if not link.state.is_failsafe:
                await link.send_setpoint(
                    Setpoint(
                        position_ned_m=pose.position_ned_m,
                        velocity_ned_m_s=(0.0, 0.0, 0.0),
                        yaw_rad=pose.attitude_rad[2],
                    )
                )
        self._pilot_flies = True
        return False

    # The way home

    async def _come_home(self) -> DronemonError | None:
        """Return and land; land here if returning fails or a person wants it. -> what failed."""
        link, loop = self._link, asyncio.get_running_loop()
        give_up_at = loop.time() + LOST_LINK_LIMIT_S
        land_here = False
        was_armed, is_lost = link.state.is_armed, False
        while link.state.is_armed and not self._pilot_flies:
            try:
                if link.state.landed is Landed.ON_GROUND:
                    await link.disarm()
                elif land_here or self._interrupts.land_now:
                    land_here = True
                    await link.land()
                else:
                    await link.return_home()
                self._note("homecoming", "landing here" if land_here else "returning")
                await self._wait_for_landing(land_here)
                give_up_at, is_lost = loop.time() + LOST_LINK_LIMIT_S, False
            except ControlTaken as exc:
                if not link.state.is_armed:
                    break
                self._note("control taken", str(exc), level="WARN")
                link.release()
                self._pilot_flies = True
                with contextlib.suppress(VehicleError):
                    await link.wait_until(
                        lambda: not link.state.is_armed or self._interrupts.land_now,
                        "the pilot's landing",
                        LANDING_LIMIT_S,
                    )
            except LinkLost as exc:
                if not is_lost:
                    self._note("link lost", str(exc), level="ERROR")
                is_lost = True
                if loop.time() > give_up_at:
                    return exc
            except (CommandRejected, CommandUnconfirmed) as exc:
                self._note("failure", str(exc), level="ERROR")
                if land_here:
                    return exc
                land_here = True
            except VehicleError as exc:
                self._note("failure", str(exc), level="ERROR")
                return exc
        if was_armed and not link.state.is_armed:
            self._note("disarmed", "the motors are off")
        return None

    async def _wait_for_landing(self, land_here: bool) -> None:
        """Wait until disarmed, or until a person wants to land here instead of at home."""
        end_s = self._link.time_s + LANDING_LIMIT_S
        while not self._is_down(land_here):
            self._status("landing here" if land_here else "returning")
            now_s = self._link.time_s
            await self._link.wait_until(
                partial(self._is_down, land_here, now_s + REPORT_INTERVAL_S),
                "landing and disarming",
                end_s - now_s,
            )

    def _is_down(self, land_here: bool, until_s: float = math.inf) -> bool:
        """Whether to wait no longer: disarmed, another way down wanted, or time to say so."""
        change = self._interrupts.land_now and not land_here
        return not self._link.state.is_armed or change or self._link.time_s >= until_s

    def _distance_from_home_m(self) -> float | None:
        state = self._link.state
        if state.home is None or state.origin is None or self._patrol is None:
            return None
        home = geo_to_ned(state.home, state.origin)
        return math.dist(self._link.pose.position_ned_m[:2], home[:2])

    # Telling

    def _status(self, phase: str) -> None:
        if self._patrol is not None:
            self._audience.status(self._patrol.status(phase))
            return
        self._audience.status(
            FlightStatus(
                phase=phase,
                horizon_au=self._mission.horizon_au,
                battery=self._link.state.battery,
                since_seen_s={target.name: None for target in self._mission.targets},
            )
        )

    def _note(self, kind: str, text: str, *, level: Level = "INFO", **fields: object) -> None:
        """Tell record, view and audience. Raises RecordError, except on the way home."""
        with contextlib.suppress(VehicleError):
            self._time_s = self._link.time_s
        self._audience.event(kind, text, level)
        self._view.event(self._time_s, kind, text, level=level)
        try:
            self._recorder.event(kind, text, time_s=self._time_s, **fields)
        except RecordError:
            if not self._is_coming_home:
                raise


def mission_kernel(mission: Mission) -> Matern32:
    """The kernel that a mission asks for."""
    belief = mission.belief
    return Matern32(
        length_scales_au=(belief.length_scale_au, belief.length_scale_au, belief.time_scale_au)
    )


def _describe_frame(frame: AreaFrame) -> dict[str, object]:
    return {
        "centre_ned_m": frame.centre_ned_m,
        "ground_down_m": frame.ground_down_m,
        "side_m": frame.side_m,
        "heading_rad": frame.heading_rad,
        "cruise_speed_m_s": frame.cruise_speed_m_s,
    }
