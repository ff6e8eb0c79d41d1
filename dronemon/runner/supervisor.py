"""Sees a flight through: gathers the situation, asks the guard, and does what it says."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable
from typing import Unpack

from dronemon.errors import (
    CameraError,
    CommandRejected,
    CommandUnconfirmed,
    ControlTaken,
    DronemonError,
    LinkLost,
    PlannerError,
    VehicleError,
)
from dronemon.events import EventStream
from dronemon.guard import (
    HOMEWARD,
    MISSION,
    Action,
    Advice,
    PatrolFacts,
    Reason,
    Setback,
    Situation,
    State,
    advise,
)
from dronemon.runner.battery import Battery
from dronemon.runner.interrupts import Interrupted, Interrupts
from dronemon.runner.last_seen import fallen
from dronemon.runner.telling import Telling, as_told
from dronemon.vehicle import UNFLOWN, Landed, Mode, Setpoint, VehicleLink

REPORT_INTERVAL_S = 1.0
"""Vehicle time between two lines of progress."""
LANDING_LIMIT_S = 900.0
"""Vehicle time for the way home and the landing."""
LOST_LINK_LIMIT_S = 120.0
"""Wall time for a lost link to come back; the autopilot flies home by itself meanwhile."""
PLANNER_LIMIT_S = 20.0
"""Vehicle time that the drone holds at a waypoint for the next one, before it returns."""
PLANNER_LIMIT_WALL_S = 5.0
"""And wall time, so that a busy machine ends no flight of a simulator that runs faster; the
detector, which a planner may have to wait for, gives up before."""
FAILSAFE_HOLD_LIMIT_S = 8.0
"""Vehicle time of a failsafe's hold: PX4 acts after COM_FAIL_ACT_T, 5 s by default."""
DISARM_LIMIT_S = 5.0
"""Vehicle time on the ground after which we disarm; PX4 does after COM_DISARM_LAND, 2 s."""
_RETRY_S = 0.5
_OUTCOMES = {
    Reason.HORIZON: "completed",
    Reason.INTERRUPTED: "interrupted",
    Reason.BATTERY_LOW: "battery low",
    Reason.TIME_UP: "battery low",
    Reason.PILOT_LANDED: "pilot",
    Reason.PILOT_KEEPS: "pilot",
}
_UNASKED = {State.RETURNING: Action.RETURN, State.LANDING: Action.LAND, State.ENDED: Action.END}
"""What is done where the guard cannot be asked; somebody else flies in the other states."""


class Supervisor:
    """What one flight has come to, and the steps that the guard asks for.

    progress: tells a line of progress of a phase; planner_name: for its errors.
    is_resumed: whether a flight of before goes on.
    outcome: as FlightResult has it; error: what went wrong first, also if the drone came home.
    was_armed: whether we armed it; is_down: whether the motors are off for sure.
    was_taken_home: whether a pilot had control on the way home.
    fallen: the last words on a drone whose motors stopped in the air.
    """

    def __init__(
        self,
        link: VehicleLink,
        events: EventStream,
        interrupts: Interrupts,
        *,
        progress: Callable[[str], None],
        battery: Battery,
        is_resumed: bool,
        planner_name: str,
    ) -> None:
        self._link, self._interrupts = link, interrupts
        self._events, self._telling = events, Telling(events)
        self._progress, self._is_resumed = progress, is_resumed
        self._report_due_s = -math.inf
        self._battery = battery
        self._planner_name = planner_name
        self.state = self._before = State.PREPARING
        self.outcome = "failed"
        self.error: DronemonError | None = None
        self.was_armed = self.is_down = self.was_taken_home = False
        self._setback = Setback.NONE
        self._problem: DronemonError | None = None  # behind the setback
        self._down_by_s: float | None = None  # while it is on its way down
        self._time_s = 0.0  # vehicle time
        self._off_ground_s = self._failsafe_s = -math.inf
        self._was_position_lost = self._has_land_worked = False
        self.fallen: str | None = None
        self._sure_at = 0  # number of the heartbeat from which "disarmed" is believed
        self._offboard_since: int | None = None  # number of the heartbeat that showed it first
        self._heard_at = math.inf
        self._is_silent = False  # the link was lost, and nothing was heard since

    # The mission's steps

    async def carry_out(self, state: State, step: Callable[[], Awaitable[object]]) -> bool:
        """Take a step of the mission, and see through what comes of it. -> whether it goes on."""
        self.state = state
        await self._attempt(step())
        if state is State.LAUNCHING:  # heartbeats are slow: it may be armed and not yet say so
            self._sure_at = self._link.num_heartbeats + 2
        return await self._see_through()

    async def come_home(self) -> None:
        """Bring the drone home, whatever the mission was doing; nothing if the flight is over."""
        while self.state is not State.ENDED:
            if self.state in MISSION:
                self._turn_back(None)
            await self._see_through()

    def _turn_back(self, problem: DronemonError | None) -> None:
        """End the mission where the guard does not; what was never ours is left alone."""
        self._leave_mission("failed", problem)
        if self.state is State.PREPARING:
            self._end(Reason.FAILED)
        self.state = State.ENDED if self.state is State.PREPARING else State.RETURNING

    def report(self, phase: str) -> None:
        """Tell a line of progress, if one is due."""
        if self._link.time_s >= self._report_due_s:
            self._report_due_s = self._link.time_s + REPORT_INTERVAL_S
            self._progress(phase)

    async def _see_through(self) -> bool:
        """Do what the guard says until the mission may go on, or nothing is left to do."""
        while self.state is not State.ENDED:
            advice = await self._advice()
            if advice.action is Action.GO_ON:
                return True
            if advice.action not in {Action.LEAVE, Action.END}:
                await self._attempt(self._do(advice.action))
        return False

    async def _advice(self) -> Advice:
        """Ask the guard. Where that fails, by a fault of ours, it is home or down all the same."""
        try:
            return self.ask()
        except Exception as exc:  # noqa: BLE001 - the drone flies
            problem = as_told(exc)
        if self.state in MISSION:
            self._turn_back(problem)
        elif self._interrupts.count >= 3:
            self._end(Reason.LEFT)
            self.state = State.ENDED
        self._meet(problem)
        await asyncio.sleep(_RETRY_S)
        return Advice(self.state, _UNASKED.get(self.state, Action.WAIT), Reason.FAILED)

    async def _attempt(self, step: Awaitable[object]) -> None:
        """Take one step; what goes wrong, be it our own fault, is the next situation's setback."""
        before = self.state
        try:
            await step
        except Interrupted:
            return  # the guard sees that a person asked
        except (Exception, asyncio.CancelledError) as exc:  # noqa: BLE001 - the same
            problem = as_told(exc)
            if before in MISSION and self.state not in MISSION:
                self._leave_mission("failed", problem)  # the guard had ended it already
            else:
                self._meet(problem)
        else:
            self._heard_at, self._is_silent = asyncio.get_running_loop().time(), False
            self._telling.is_over()
        if self._setback is Setback.FAILED and self.state not in MISSION:
            await asyncio.sleep(_RETRY_S)

    def _meet(self, problem: DronemonError) -> None:
        """Make a setback of an error; on the way home it is told, again and again."""
        self._problem, self._down_by_s = problem, None
        kind = "failure"
        match problem:
            case ControlTaken():
                self._setback = Setback.FAILSAFE if problem.by_failsafe else Setback.PILOT
                self._failsafe_s = self._time_s
                return  # told when the guard has judged it
            case LinkLost():
                self._setback, kind, self._is_silent = Setback.LINK_LOST, "link lost", True
            case CommandRejected() | CommandUnconfirmed():
                self._setback = Setback.REFUSED
                self._was_position_lost &= self.state is not State.RETURNING
            case _:
                self._setback = Setback.FAILED
        if self.state not in MISSION:
            self._telling.problem(kind, problem)

    # Asking

    def ask(self, **patrol: Unpack[PatrolFacts]) -> Advice:
        """Ask the guard, tell what is new, and go over to the state that it gives."""
        self._telling.interrupts(self._interrupts.count, self.state)
        situation = self._situation(patrol)
        advice = advise(situation)
        if advice.state is not self.state or situation.setback is Setback.FAILSAFE:
            self._change(advice)
        if advice.action is not Action.WATCH:
            self._down_by_s = None
        elif self._down_by_s is None:
            self._down_by_s = self._time_s + LANDING_LIMIT_S
        self.state = advice.state
        self._setback = Setback.LINK_LOST if self._is_silent else Setback.NONE
        return advice

    def hear_armed(self) -> None:
        """We armed it: from now on it is ours."""
        self.was_armed = True

    def _keep_track(self) -> None:
        """Keep what the newest state alone does not tell: since when something has been so."""
        state, number = self._link.state, self._link.num_heartbeats
        with contextlib.suppress(VehicleError):  # not heard yet
            self._time_s = self._link.time_s
        now_s = self._time_s
        if state.is_armed:
            self.was_armed |= self.state is not State.PREPARING
            if not state.is_doubted:
                self._sure_at = number + 2
        if state.landed is not Landed.ON_GROUND:
            self._off_ground_s = now_s
        self._was_position_lost |= not state.is_position_good
        if state.mode is not Mode.OFFBOARD or state.is_doubted:
            self._offboard_since = None
        elif self._offboard_since is None:
            self._offboard_since = number
        self._battery.take()

    def _is_sure(self) -> bool:
        return self._link.num_heartbeats >= self._sure_at and not self._link.state.are_two

    def _situation(self, patrol: PatrolFacts) -> Situation:
        self._keep_track()
        state, number, now_s = self._link.state, self._link.num_heartbeats, self._time_s
        is_on_ground = state.landed is Landed.ON_GROUND
        return Situation(
            state=self.state,
            before=self._before,
            setback=self._setback,
            is_armed=state.is_armed,
            may_attach=self._is_resumed and not is_on_ground and state.mode in UNFLOWN,
            is_sure=self._is_sure(),
            are_two=state.are_two,
            is_on_ground=is_on_ground,
            is_on_ground_long=is_on_ground and now_s > self._off_ground_s + DISARM_LIMIT_S,
            is_position_good=state.is_position_good,
            is_battery_low=self._battery.is_low,
            is_time_up=self._battery.is_time_up,
            is_offboard=self._offboard_since is not None and number > self._offboard_since,
            is_holding=state.mode is Mode.HOLD,
            is_failsafe=state.is_failsafe,
            is_failsafe_long=now_s > self._failsafe_s + FAILSAFE_HOLD_LIMIT_S,
            is_coming_down=state.mode in {Mode.RETURN, Mode.LAND},
            is_position_back=state.is_position_good and self._was_position_lost,
            is_down_under_way=self._down_by_s is not None,
            is_overridden=self._has_land_worked and state.has_sticks,
            times_interrupted=self._interrupts.count,
            is_lost_for_long=self._interrupts.is_hopeless
            or asyncio.get_running_loop().time() > self._heard_at + LOST_LINK_LIMIT_S,
            **patrol,
        )

    def _change(self, advice: Advice) -> None:
        """Tell of a new state, and let go of the vehicle where it is in other hands."""
        is_over = advice.state in {State.HEADING_HOME, *HOMEWARD, State.ENDED}
        if self.state is State.HEADING_HOME and is_over:  # what it came to is known
            if (error := self._error(advice.reason)) is not None:
                self._telling.problem("failure", error)
        elif self.state in MISSION and is_over:
            self._leave_mission(_OUTCOMES.get(advice.reason, "failed"), self._error(advice.reason))
            if advice.reason in {Reason.BATTERY_LOW, Reason.TIME_UP}:
                self._events.note("battery", f"{advice.reason}: {self._battery}")
        elif advice.state is State.PILOT:
            self.was_taken_home |= self.state in HOMEWARD
            self._let_go("control taken")
        elif self.state is State.PILOT and advice.state is not State.ENDED:
            self._events.note("control given back", "the mode is offboard again")
            self._link.reclaim()
            self._events.must_go_on = advice.state is not State.PATROLLING
            if self._before is State.LAUNCHING:  # too early to go on
                self._leave_mission("failed", self._problem)
        elif self._setback is Setback.FAILSAFE:
            self._let_go("failsafe")
        if advice.action is Action.END:
            self._end(advice.reason)

    def _let_go(self, kind: str) -> None:
        """Somebody else chose the mode: from now on any is welcome."""
        self._events.must_go_on = True
        if self._setback is Setback.NONE:
            self._problem = ControlTaken(
                f"mode '{self._link.state.mode}' is none that we asked for"
            )
        self._telling.problem(kind, self._problem, "WARN")
        self._link.release()
        is_unasked = self.state is State.LANDING and not self._has_land_worked
        self._before = State.RETURNING if is_unasked else self.state
        self._heard_at = asyncio.get_running_loop().time()

    def _leave_mission(self, outcome: str, error: DronemonError | None) -> None:
        self._events.must_go_on = True
        self.outcome = outcome
        self._heard_at = asyncio.get_running_loop().time()
        if error is not None:
            self.error = error
            self._telling.problem("failure", error)

    def _error(self, reason: Reason) -> DronemonError | None:
        """The error that ends a mission for this reason; None if it is none."""
        if self._setback is not Setback.NONE:
            return self._problem
        if reason in _OUTCOMES or reason is Reason.THERE:
            return None
        if reason is Reason.PLANNER_LATE:
            return PlannerError(
                f"no waypoint from planner '{self._planner_name}' for {PLANNER_LIMIT_S:g} s of "
                "vehicle time after it was due; the drone returns"
            )
        error = CameraError if reason is Reason.BLIND else VehicleError
        state = self._link.state
        battery = "unknown" if state.battery is None else f"{state.battery:.0%}"
        return error(f"{reason} ({state.describe()}, battery {battery})")

    def _end(self, reason: Reason) -> None:
        """The last state is known: what the program says from now on is about the past."""
        if self.state is State.PILOT and (self._before in MISSION or self.outcome == "battery low"):
            self.outcome = _OUTCOMES.get(reason, "failed")
        is_heard = reason not in {Reason.LOST_FOR_GOOD, Reason.LEFT}
        if not is_heard:
            self.error = self.error or self._problem
        is_sure = self._is_sure() or not self.was_armed
        self.is_down = is_heard and is_sure and not self._link.state.is_armed
        if self.is_down and self.was_armed:
            self.fallen = fallen(self._link)
            if self.fallen:
                self._leave_mission("failed", None if self.error else VehicleError(self.fallen))
            self._events.note("disarmed", self.fallen or str(reason))

    # Doing

    async def _do(self, action: Action) -> None:
        link = self._link
        match action:
            case Action.RETURN | Action.LAND:
                await (link.land() if action is Action.LAND else link.return_home())
                self._has_land_worked |= action is Action.LAND
                self._events.note("homecoming", str(self.state))
                self._down_by_s = link.time_s + LANDING_LIMIT_S
            case Action.DISARM:
                await link.disarm()
            case _:
                async with self._interrupts.leaving(self._interrupts.count):
                    await self._wait(action)

    async def _wait(self, action: Action) -> None:
        match action:
            case Action.LISTEN:
                await self._link.next_heartbeat()
            case Action.WATCH:
                await self._watch()
            case Action.OFFER:
                await self._offer()
            case Action.WAIT:
                await self._link.next_pose()

    async def _watch(self) -> None:
        """Wait until disarmed, or until a line is due."""
        self._progress(str(self.state))
        assert self._down_by_s is not None  # the guard said WATCH
        now_s = self._link.time_s
        await self._link.wait_until(
            lambda: not self._link.state.is_armed or self._link.time_s >= now_s + REPORT_INTERVAL_S,
            "landing and disarming",
            self._down_by_s - now_s,
        )

    async def _offer(self) -> None:
        """Send a setpoint for the present place, so that the pilot can choose offboard."""
        pose = self._link.pose
        self.report(str(self.state))
        await self._link.send_setpoint(
            Setpoint(
                position_ned_m=pose.position_ned_m,
                velocity_ned_m_s=(0.0, 0.0, 0.0),
                yaw_rad=pose.attitude_rad[2],
            )
        )
        await self._link.next_pose()
