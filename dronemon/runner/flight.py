"""The mission's story: get ready, take off, patrol, come home, land; whatever fails, come home."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial

from dronemon.energy import RETURN_PARAMETERS
from dronemon.errors import DronemonError, PlannerError, RecordError, VehicleError
from dronemon.events import EventStream, Moved
from dronemon.frames import AreaFrame
from dronemon.guard import State
from dronemon.preflight import Sight, Verdict, against
from dronemon.roadmap import Roadmap
from dronemon.runner.battery import Battery
from dronemon.runner.daemon import in_daemon_thread
from dronemon.runner.ground import Ground
from dronemon.runner.history import GOING_ON
from dronemon.runner.inspection import aim, find, home_m, look, refusal
from dronemon.runner.last_seen import LastSeen, last_seen
from dronemon.runner.patrol import Patrol
from dronemon.runner.preparation import FlightSetup, brief, draw_start_and_roadmap
from dronemon.runner.routes import Routes
from dronemon.runner.supervisor import Supervisor
from dronemon.runner.tally import Tally, progress
from dronemon.types import FloatArray, Vector3
from dronemon.vehicle import Landed, Mode
from dronemon.vehicle.changes import Changes, ChangesTaken

NOT_STARTED = "nothing has flown: the motors were not started"
NOT_STARTED_AGAIN = "it did not take off again: the motors were not started"
DOWN = "the drone is down, and its motors are off"
_RESET_LIMIT_S = 30.0
"""Wall time for the planner to begin a mission, as it has done in the rehearsal."""
_RECALL_LIMIT_S = 0.1
"""Wall time more, for each picture of before that it takes in."""
_POSE_INTERVAL_S = 0.1
"""Wall time between two poses that are told outside the patrol."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightResult:
    """How a flight ended.

    outcome: `completed`, `interrupted`, `battery low`, `pilot` (took over) or `failed`;
    was_taken_home: whether a pilot had control on the way home.
    has_flown: whether it was armed; is_landed: whether it is down with its motors off, for sure; if
    not, last_seen has the last words, or fallen where the motors stopped in the air.
    landing_error_m: distance from where it was armed, None if it did not take off or land, or if
    its position was not good; landing_battery: the last level in the air; tally: what the patrol
    did, before a resume too; None if it never began; error: what went wrong, also if the drone came
    home after it.
    """

    outcome: str
    has_flown: bool
    is_landed: bool
    last_seen: LastSeen | None
    landing_error_m: float | None
    landing_battery: float | None
    tally: Tally | None
    error: DronemonError | None
    was_taken_home: bool = False
    fallen: str | None = None
    is_resumed: bool = False

    @property
    def last_word(self) -> str:
        """What a person must know in the end: whether the motors may still run."""
        if self.last_seen is not None:
            return self.last_seen.words
        if self.fallen is not None:
            return self.fallen
        if not self.has_flown:
            return NOT_STARTED_AGAIN if self.is_resumed else NOT_STARTED
        return DOWN


async def fly_mission(setup: FlightSetup) -> FlightResult:
    """Fly one mission with a connected vehicle and a camera to open, from ready to disarmed.

    `rehearse` comes first, or what is compiled and loaded in flight will hold up the setpoints.
    Never raises a DronemonError: what went wrong is in the result, after the drone came home.
    Cancelling it is a person's interrupt: nobody walks away from a drone, and the result comes.
    """
    caller = asyncio.current_task()
    assert caller is not None
    flight = asyncio.create_task(_Flight(setup).run(), name="flight")
    while not flight.done():
        try:
            await asyncio.wait([flight])
        except asyncio.CancelledError:
            caller.uncancel()
            setup.interrupts.request()
    return flight.result()


class _Flight:
    def __init__(self, setup: FlightSetup) -> None:
        self._setup, self._history = setup, setup.history
        self._mission, self._link = setup.file.mission, setup.link
        self._events = EventStream(setup.record, setup.audience, setup.link)
        self._battery = Battery(setup.link, self._mission.flight)
        self._supervisor = Supervisor(
            setup.link,
            self._events,
            setup.interrupts,
            progress=self._progress,
            battery=self._battery,
            is_resumed=setup.history is not None,
            planner_name=setup.planner.name,
        )
        self._changes = Changes(setup.link, partial(self._events.note, "parameters"))
        self._patrol: Patrol | None = None
        self._rest: asyncio.Task[None] | None = None
        self._is_attached = False  # to a vehicle in the air
        self._home_ned_m: Vector3 | None = None  # where it was armed: PX4 moves home at landing

    async def run(self) -> FlightResult:
        supervisor = self._supervisor
        try:
            await self._see_through()
        except Exception as exc:  # noqa: BLE001 - the drone has come home: its story is known
            supervisor.error = supervisor.error or DronemonError(f"after the flight: {exc!r}")
        is_landed = supervisor.is_down and supervisor.fallen is None
        return FlightResult(
            outcome=supervisor.outcome,
            has_flown=supervisor.was_armed,
            is_landed=is_landed,
            last_seen=None if supervisor.is_down else last_seen(self._link),
            landing_error_m=self._distance_from_home_m() if is_landed else None,
            landing_battery=self._battery.flown_to if is_landed else None,
            tally=self._tally(),
            error=supervisor.error,
            was_taken_home=supervisor.was_taken_home,
            fallen=supervisor.fallen,
            is_resumed=self._history is not None,
        )

    def _tally(self) -> Tally | None:
        """What the run came to, also if this part of it never began to patrol."""
        part = self._patrol if self._patrol and self._patrol.tally else self._history
        return part.tally if part else None

    async def _see_through(self) -> None:
        supervisor = self._supervisor
        async with contextlib.AsyncExitStack() as self._exit:  # closes the camera
            self._exit.enter_context(self._changes)
            async with asyncio.TaskGroup() as self._meanwhile:
                listening = [
                    self._beside(self._tell_texts, "texts"),
                    self._beside(self._tell_poses, "poses"),
                ]
                try:
                    if await supervisor.carry_out(
                        State.PREPARING, self._prepare
                    ) and await supervisor.carry_out(State.LAUNCHING, self._launch):
                        while await supervisor.carry_out(State.PATROLLING, self._fly_patrol):
                            pass  # the pilot gave control back
                finally:
                    await supervisor.come_home()
                    if not supervisor.is_down:
                        words = last_seen(self._link).words + self._changes.last_words()
                        self._events.note("last word", words, level="ERROR")
                    await self._leave_as_found()
                    for task in listening:
                        task.cancel()
            self._tell_losses()
            self._events.note("outcome", supervisor.outcome)

    # On the ground

    async def _prepare(self) -> None:
        """Get ready; where a vehicle lands meanwhile that was to be met in the air, once more."""
        if self._history is not None:
            self._events.note(GOING_ON, "goes on with what the run has come to")
        async with self._setup.interrupts.leaving():
            link, limit_s = self._link, self._mission.vehicle.ready_timeout_s
            self._progress("waiting for the vehicle")
            await link.wait_ready(limit_s)
            await self._exit.enter_async_context(self._setup.camera)  # its clock is the vehicle's
            await self._get_ready()
            await link.next_heartbeat()  # the guard judges a fresh state
            if self._is_attached and link.state.landed is Landed.ON_GROUND:
                self._progress("waiting until it has disarmed")
                await link.wait_until(lambda: not link.state.is_armed, "disarming", limit_s)
                await link.wait_ready(limit_s)
                await self._get_ready()
                await link.next_heartbeat()
            self._refuse_to_take_over()
            if self._is_flown_already():
                self._supervisor.ask(is_horizon_flown=True)

    async def _get_ready(self) -> None:
        """Lay the area over the ground, try the camera, brief the planner."""
        setup, mission, link = self._setup, self._mission, self._link
        self._is_attached = setup.history is not None and link.state.is_armed
        self._changes.claim()
        if not self._is_attached:
            await self._changes.put_back()  # what a flight before this one left
        await self._changes.make(setup.settings)
        gimbal = await aim(setup)
        sight = await look(setup)
        ground = Ground(setup, self._events, self._changes, is_attached=self._is_attached)
        frame = await ground.lay_area()
        self._battery.parameters = await link.read_parameters(RETURN_PARAMETERS)
        self._refuse_to_take_over()
        if not self._is_attached:
            await self._check_fitness(sight, frame, gimbal)
        profile, fence = ground.lay_profile(frame), await ground.lay_fence(frame)
        self._launch_m = profile.height_m(home_m(link), frame.ground_down_m)
        routes = Routes(frame, home_m(link))
        if not routes.are_straight:
            self._battery.legs_home = routes.legs_home
            self._battery.end_m = self._launch_m if self._mission.flight.follow_terrain else None
        start_au, roadmap = draw_start_and_roadmap(mission)
        await self._brief_planner(start_au, roadmap)
        self._tell_resumed(frame)
        ground.tell(frame, fence, roadmap)
        self._patrol = Patrol(
            setup,
            self._supervisor,
            self._events,
            self._battery,
            frame=frame,
            profile=profile,
            fence=fence,
            routes=routes,
            roadmap=roadmap,
            start_au=start_au,
        )

    async def _brief_planner(self, start_au: FloatArray, roadmap: Roadmap) -> None:
        """Tell it all that is known: what it makes of a long log takes seconds."""
        setup, tally = self._setup, self._tally()
        log = tally.sightings if tally else None
        limit_s = _RESET_LIMIT_S  # of a drone that hovers meanwhile
        if log and not self._is_attached:
            limit_s += _RECALL_LIMIT_S * len(log)
        briefing = brief(self._mission, setup.priors_au, start_au, stream="planner", sightings=log)
        reset = partial(setup.planner.reset, briefing, roadmap)
        who = f"planner '{setup.planner.name}'"
        await in_daemon_thread(reset, who, PlannerError, limit_s)

    def _refuse_to_take_over(self) -> None:
        """Leave a vehicle in the air to its pilot, or to an autopilot that has to bring it down.

        A failsafe's hold or return alone is how a program that was killed leaves it. Raises
        VehicleError.
        """
        state, history, why = self._link.state, self._history, ""
        if history is None or not self._is_attached:
            return
        self._battery.take()
        if history.is_pilots:
            why = "a pilot took control on this flight, and did not give it back"
        elif state.mode is Mode.LAND and state.is_failsafe:
            why = "a failsafe of the autopilot lands it"
        elif state.mode in {Mode.RETURN, Mode.LAND} and self._battery.is_low:
            why = f"it is on its way down with what its battery has ({self._battery})"
        if why:
            rest = "it is left as it is, and nothing was commanded; wait until it is down"
            raise VehicleError(f"{why}: {rest}, then resume")

    async def _check_fitness(self, sight: Sight, frame: AreaFrame, gimbal: str | None) -> None:
        """Tell what is not as it should be. Raises VehicleError where it must not fly so."""
        setup = self._setup
        findings = await find(setup, sight, frame=frame, gimbal=gimbal)
        if error := refusal(findings, setup.folder if setup.history else None):
            raise error
        for finding in against(findings, Verdict.WARNING):
            self._events.note("preflight", str(finding), level="WARN")

    def _is_flown_already(self) -> bool:
        """Whether a run that goes on from the ground has its last picture."""
        tally, num_pictures = self._tally(), self._mission.num_pictures
        return bool(tally and tally.num_pictures_due >= num_pictures) and not self._is_attached

    def _tell_resumed(self, frame: AreaFrame) -> None:
        """Tell where a run goes on, if one does."""
        if self._history and (tally := self._history.tally):
            old_s = self._link.time_s - tally.start_s - frame.au_to_s(tally.sightings.time_au)
            what = f"goes on at {tally.flown_m / frame.side_m:.1f} of "
            what += f"{self._mission.horizon_au:g} au; the last picture is {old_s:.0f} s old"
            self._events.note("resumed", what, start_s=tally.start_s)

    # In the air

    async def _launch(self) -> None:
        """Arm and climb; a flight that goes on in the air is taken over in Hold."""
        if self._is_attached:
            await self._attach()
            return
        self._progress("arming")
        await self._link.arm()  # not interruptible: it could arm after nobody waits any more
        self._home_ned_m = self._link.pose.position_ned_m
        self._supervisor.hear_armed()
        self._events.note("armed", "motors are running", home_ned_m=self._home_ned_m)
        async with self._setup.interrupts.leaving():
            self._progress("taking off")
            await self._link.take_off(self._launch_m)
        self._events.note("airborne", f"at {self._launch_m:g} m")

    async def _attach(self) -> None:
        assert self._history is not None
        if not self._link.state.is_armed or self._link.state.landed is Landed.ON_GROUND:
            raise VehicleError("it has landed meanwhile: resume again once it is disarmed")
        if armed := self._history.armed:
            self._home_ned_m = armed.home_ned_m
            self._battery.go_on(self._link.time_s - armed.time_s)
        self._supervisor.hear_armed()
        await self._link.hold()
        self._events.note("attached", "taken over in the air")

    async def _fly_patrol(self) -> None:
        """Patrol; what was taken and not looked at by its end is looked at on the way home."""
        assert self._patrol is not None  # it is prepared
        if self._rest is not None:
            self._rest.cancel()  # the patrol goes on, and looks itself
        pointing = self._beside(self._point_down, "the gimbal")
        try:
            await self._patrol.run()
        finally:
            pointing.cancel()  # whoever flies from here on is left alone
            self._rest = self._beside(self._patrol.look_at_the_rest, "the last picture")

    async def _point_down(self) -> None:  # PX4 has turned it ahead if it was on its way home
        if self._mission.camera.gimbal:
            await self._link.point_down()

    def _beside(self, what: Callable[[], Awaitable[None]], name: str) -> asyncio.Task[None]:
        """Do something beside the flight; if it fails, the flight goes on."""

        async def do() -> None:
            try:
                await what()
            except Exception as exc:  # noqa: BLE001 - it would cancel the way home
                with contextlib.suppress(RecordError):  # the patrol's next line meets it too
                    self._events.note("failure", f"{name} lost: {exc!r}", level="WARN")

        return self._meanwhile.create_task(do(), name=name)

    async def _leave_as_found(self) -> None:
        """After our flight: parameters as they were, and Hold.

        PX4 would else want OFFBOARD again, in which it cannot be armed.
        """
        if self._supervisor.is_down or not self._supervisor.was_armed:
            try:
                await self._changes.put_back()
            except ChangesTaken:
                pass  # by another program, before we changed anything; the flight's error says so
            except DronemonError as exc:
                what = f"{exc}; what is not put back will be at the next start"
                self._events.note("parameters", what, level="ERROR")
        is_ours = self._supervisor.was_armed and self._supervisor.outcome != "pilot"
        if is_ours and self._supervisor.is_down and self._link.state.mode is not Mode.HOLD:
            with contextlib.suppress(DronemonError):
                await self._link.hold()

    # Telling

    def _progress(self, phase: str) -> None:
        """Tell how far the flight is."""
        link, pose = self._link, self._link.pose if self._patrol else None
        self._events.emit(
            progress(
                phase,
                self._mission,
                self._tally(),
                pose.time_s if pose else None,  # before, its clock may not be the run's
                battery=link.state.battery,
                battery_needed=self._battery.needed,
                speed_m_s=pose.ground_speed_m_s if pose else 0.0,
            )
        )

    def _tell_losses(self) -> None:
        """Tell what was left out on the way, if anything."""
        lost = self._setup.audience.losses()
        if number := self._link.state.num_unreadable:
            lost.append(f"{number} messages of the vehicle that could not be read")
        for what in lost:
            self._events.note("left out", what, level="WARN")

    async def _tell_texts(self) -> None:
        """Tell what the autopilot says when it says it."""
        while True:
            for said in await self._link.next_texts():
                with contextlib.suppress(RecordError):  # the patrol's next line meets it too
                    self._events.note("autopilot", said.text, level=said.level)

    async def _tell_poses(self) -> None:
        """Tell where the vehicle is from arming to the end; the patrol tells it by itself."""
        while True:
            await asyncio.sleep(_POSE_INTERVAL_S)
            is_told = self._supervisor.state in {State.PATROLLING, State.HEADING_HOME}
            is_ours = self._supervisor.was_armed and not is_told
            if is_ours and self._patrol is not None and not self._patrol.has_origin_moved():
                with contextlib.suppress(RecordError):  # the patrol's next line meets it too
                    self._events.emit(Moved(pose=self._link.pose))

    def _distance_from_home_m(self) -> float | None:
        is_told = self._patrol is not None and not self._patrol.has_origin_moved()
        if self._home_ned_m is None or not is_told or not self._link.state.is_position_good:
            return None
        with contextlib.suppress(VehicleError):  # it has rebooted, and is not heard yet
            return math.dist(self._link.pose.position_ned_m[:2], self._home_ned_m[:2])
        return None
