"""Sees a flight through: gathers the situation, asks the guard, and does what it says."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable

from dronemon.errors import (
    CommandRejected,
    CommandUnconfirmed,
    ControlTaken,
    DronemonError,
    LinkLost,
    PlannerError,
    VehicleError,
)
from dronemon.events import EventStream, Level
from dronemon.guard import (
    HOMEWARD,
    MISSION,
    Action,
    Advice,
    Reason,
    Setback,
    Situation,
    State,
    advise,
)
from dronemon.runner.interrupts import Interrupted, Interrupts
from dronemon.vehicle import Landed, Mode, Setpoint, VehicleLink

REPORT_INTERVAL_S = 1.0
"""Vehicle time between two lines of progress."""
LANDING_LIMIT_S = 900.0
"""Vehicle time for the way home and the landing."""
LOST_LINK_LIMIT_S = 120.0
"""Wall time for a lost link to come back; the autopilot flies home by itself meanwhile."""
FAILING_LIMIT_S = 120.0
"""Wall time in which returning and landing are asked for in turn, while both are refused."""
PLANNER_LIMIT_S = 4.0
"""Vehicle time after a waypoint was due at which the mission loop counts as hung."""
PLANNER_LIMIT_WALL_S = 1.0
"""And wall time, so that a busy machine ends no flight of a simulator that runs faster."""
_HEARTBEATS_TO_BE_SURE = 2
_OUTCOMES = {
    Reason.HORIZON: "completed",
    Reason.INTERRUPTED: "interrupted",
    Reason.BATTERY_LOW: "battery low",
    Reason.PILOT_LANDED: "pilot",
    Reason.PILOT_KEEPS: "pilot",
}
_GIVEN_UP = {Reason.BROKEN, Reason.LOST_FOR_GOOD, Reason.REFUSED_FOR_GOOD}
_SECOND = {
    State.PILOT: "the pilot flies on; Ctrl-C again ends the program and leaves it to the pilot",
    State.LANDING: "the drone is landing here already",
}


class Supervisor:
    """What one flight has come to, and the steps that the guard asks for.

    progress: tells a line of progress of a phase; return_battery: level at which to return.
    planner_name: for its errors.
    outcome: `completed`, `interrupted`, `battery low`, `pilot` (took over) or `failed`; error: what
    went wrong first, also if the drone came home after it.
    """

    def __init__(
        self,
        link: VehicleLink,
        events: EventStream,
        interrupts: Interrupts,
        *,
        progress: Callable[[str], None],
        return_battery: float,
        planner_name: str,
    ) -> None:
        self._link = link
        self._events = events
        self._interrupts = interrupts
        self._progress = progress
        self._report_due_s = -math.inf
        self._return_battery = return_battery
        self._planner_name = planner_name
        self.state = self._before = State.PREPARING
        self.outcome = "failed"
        self.error: DronemonError | None = None
        self._setback = Setback.NONE
        self._problem: DronemonError | None = None  # behind the setback
        self._down_by_s: float | None = None  # while it is on its way down
        self._num_unheard = 0
        self._was_armed = False
        self._told: object = None  # the problem told last, while nothing succeeds
        self._heard_at = math.inf
        self._refused_since = math.inf
        self._is_second_told = False

    # The mission's steps

    async def carry_out(self, state: State, step: Callable[[], Awaitable[object]]) -> bool:
        """Take a step of the mission, and see through what comes of it. -> whether it goes on."""
        self.state = state
        if state is State.LAUNCHING:  # heartbeats are slow: it may be armed and not yet say so
            self._num_unheard = _HEARTBEATS_TO_BE_SURE
        await self._attempt(step())
        return await self._see_through()

    async def come_home(self) -> None:
        """Bring the drone home, whatever the mission was doing; nothing if the flight is over."""
        while self.state is not State.ENDED:
            if self.state in MISSION:
                self._leave_mission("failed", None)
                self.state = State.RETURNING
            await self._see_through()

    def report(self, phase: str) -> None:
        """Tell a line of progress, if one is due."""
        if self._link.time_s >= self._report_due_s:
            self._report_due_s = self._link.time_s + REPORT_INTERVAL_S
            self._progress(phase)

    async def _see_through(self) -> bool:
        """Do what the guard says until the mission may go on, or nothing is left to do."""
        while (advice := self.ask()).action not in {Action.GO_ON, Action.END}:
            if advice.action is not Action.LEAVE:
                await self._attempt(self._do(advice.action))
        return advice.action is Action.GO_ON

    async def _attempt(self, step: Awaitable[object]) -> None:
        """Take one step; what goes wrong is the next situation's setback."""
        before = self.state
        try:
            await step
        except Interrupted:
            pass  # the guard sees that a person asked
        except DronemonError as exc:
            if before in MISSION and self.state not in MISSION:
                self._leave_mission("failed", exc)  # the guard had ended it already
            elif before in HOMEWARD and self._num_unheard and not self._link.state.is_armed:
                self._num_unheard = 0  # nothing more is heard of it
            else:
                self._meet(exc)
        else:
            self._heard_at, self._told = asyncio.get_running_loop().time(), None

    def _meet(self, exc: DronemonError) -> None:
        """Make a setback of an error; on the way home the first of a kind is told."""
        self._problem, self._down_by_s = exc, None
        is_homeward = self.state in HOMEWARD
        match exc:
            case ControlTaken():
                self._setback = Setback.FAILSAFE if exc.by_failsafe else Setback.PILOT
            case LinkLost():
                self._setback = Setback.LINK_LOST
                if is_homeward:
                    self._tell("link lost", exc)
            case CommandRejected() | CommandUnconfirmed():
                self._setback = Setback.REFUSED
                if is_homeward and math.isinf(self._refused_since):
                    self._refused_since = asyncio.get_running_loop().time()
                    self._tell("failure", exc)
            case _:
                self._setback = Setback.FAILED

    # Asking

    def ask(self, *, is_horizon_flown: bool = False, is_planner_late: bool = False) -> Advice:
        """Ask the guard, tell what is new, and go over to the state that it gives."""
        if self._interrupts.count and not self._is_second_told:
            self._is_second_told = self._events.must_go_on = True
            what = _SECOND.get(
                self.state, "the drone comes home; Ctrl-C again lands it where it is"
            )
            self._events.note("interrupt", what)
        situation = self._situation(is_horizon_flown, is_planner_late)
        advice = advise(situation)
        if advice.state is not self.state or situation.setback is Setback.FAILSAFE:
            self._change(advice)
        if advice.action is not Action.WATCH:
            self._down_by_s = None
        elif self._down_by_s is None:
            self._down_by_s = self._link.time_s + LANDING_LIMIT_S
        self.state, self._setback = advice.state, Setback.NONE
        return advice

    def _situation(self, is_horizon_flown: bool, is_planner_late: bool) -> Situation:
        state, now = self._link.state, asyncio.get_running_loop().time()
        if state.is_armed:
            self._num_unheard = 0
            self._was_armed = self._was_armed or self.state in HOMEWARD
        return Situation(
            state=self.state,
            before=self._before,
            setback=self._setback,
            is_armed=state.is_armed,
            is_sure=not self._num_unheard,
            is_on_ground=state.landed is Landed.ON_GROUND,
            is_position_good=state.is_position_good,
            is_battery_low=state.battery is not None and state.battery <= self._return_battery,
            is_offboard=state.mode is Mode.OFFBOARD,
            is_failsafe=state.is_failsafe,
            is_coming_down=state.mode in {Mode.RETURN, Mode.LAND},
            is_down_under_way=self._down_by_s is not None,
            times_interrupted=self._interrupts.count,
            is_horizon_flown=is_horizon_flown,
            is_planner_late=is_planner_late,
            is_lost_for_long=now > self._heard_at + LOST_LINK_LIMIT_S,
            is_refused_for_long=now > self._refused_since + FAILING_LIMIT_S,
        )

    def _change(self, advice: Advice) -> None:
        """Tell of a new state, and let go of the vehicle where it is in other hands."""
        if self.state in MISSION and advice.state in HOMEWARD:
            self._leave_mission(_OUTCOMES.get(advice.reason, "failed"), self._error(advice.reason))
        elif advice.state is State.PILOT:
            self._take_note("control taken")
            self._before = self.state
        elif advice.action is Action.END:
            self._end(advice.reason)
        elif self.state is State.PILOT:
            self._events.note("control given back", "the mode is offboard again")
            self._events.must_go_on = advice.state is not State.PATROLLING
            if self._before is State.LAUNCHING:  # too early to go on
                self._leave_mission("failed", self._problem)
        elif self._setback is Setback.FAILSAFE:
            self._take_note("failsafe")
            self._before = self.state

    def _take_note(self, kind: str) -> None:
        """Somebody else chose the mode: from now on any is welcome."""
        self._events.must_go_on = True
        self._tell(kind, self._problem, "WARN")
        self._link.release()
        self._heard_at = asyncio.get_running_loop().time()

    def _leave_mission(self, outcome: str, error: DronemonError | None) -> None:
        self._events.must_go_on = True
        self.outcome = outcome
        self._heard_at = asyncio.get_running_loop().time()
        if error is not None:
            self.error = error
            self._tell("failure", error)

    def _tell(self, kind: str, problem: DronemonError | None, level: Level = "ERROR") -> None:
        """Tell a problem, once while it lasts."""
        is_same = LinkLost if isinstance(problem, LinkLost) else str(problem)
        if is_same != self._told:
            self._told = is_same
            self._events.note(kind, str(problem), level=level)

    def _error(self, reason: Reason) -> DronemonError | None:
        """The error that ends a mission for this reason; None if it is none."""
        if self._setback is not Setback.NONE:
            return self._problem
        if reason is Reason.PLANNER_LATE:
            return PlannerError(
                f"no waypoint from planner '{self._planner_name}' for {PLANNER_LIMIT_S:g} s of "
                "vehicle time after it was due; the drone returns"
            )
        return None if reason in _OUTCOMES else VehicleError(str(reason))

    def _end(self, reason: Reason) -> None:
        if self.state is State.PILOT and self._before in MISSION:
            self.outcome = _OUTCOMES.get(reason, "failed")
        if reason in _GIVEN_UP:
            self.error = self.error or self._problem
            if reason is Reason.BROKEN or self.state is State.PILOT:  # else told before
                self._tell("failure", self._problem)
        elif reason is Reason.MOTORS_OFF and self._was_armed:
            self._events.note("disarmed", str(reason))

    # Doing

    async def _do(self, action: Action) -> None:
        link = self._link
        match action:
            case Action.RETURN | Action.LAND:
                await (link.land() if action is Action.LAND else link.return_home())
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
                self._num_unheard = max(self._num_unheard - 1, 0)
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
