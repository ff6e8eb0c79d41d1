"""The patrol: fly from waypoint to waypoint, take a picture every 0.1 au, believe, choose, go on.

Three tasks share it. `_guide` answers every pose with a setpoint, and says when a picture or a
waypoint is due; the observer takes the picture at that moment; `_watch` asks the planner, if a
waypoint is due, or looks at the oldest picture, one after the other, in threads.
"""

from __future__ import annotations

import asyncio
import math
import time
from functools import partial

from dronemon.errors import PlannerError, VehicleError
from dronemon.events import Attended, Decided, EventStream, Moved
from dronemon.fence import Fence
from dronemon.frames import AreaFrame, geo_to_ned
from dronemon.guard import Action, State
from dronemon.guidance import Carrot, Point
from dronemon.planner import Snapshot
from dronemon.planner.motion import until_measurement_au
from dronemon.problem import MEASUREMENT_INTERVAL_AU
from dronemon.roadmap import Roadmap
from dronemon.runner.battery import Battery
from dronemon.runner.daemon import in_daemon_thread
from dronemon.runner.deciding import decide
from dronemon.runner.history import ORIGIN_DOUBT_M
from dronemon.runner.observer import Observer
from dronemon.runner.peace import Peace
from dronemon.runner.preparation import FlightSetup
from dronemon.runner.profile import Profile
from dronemon.runner.routes import Routes
from dronemon.runner.supervisor import PLANNER_LIMIT_S, PLANNER_LIMIT_WALL_S, Supervisor
from dronemon.runner.tally import Tally
from dronemon.types import FloatArray, Pose
from dronemon.vehicle import Setpoint

SETPOINT_INTERVAL_S = 0.05
"""Vehicle time between setpoints: 20 Hz, far from the 2 Hz that PX4 needs."""
_STILL: Point = (0.0, 0.0)
_NEXT_PICTURE_AU = 0.03
"""A picture due no farther than this after a waypoint is told as taken: no leg is for it alone."""
_SLOW_S, _SLOW_WALL_S = 1.0, 0.5
"""Vehicle time, and wall time, after which it is told that there is no waypoint."""
_OFF_PATH_S = 3.0
"""Vehicle time for which the drone may be far from its path or its height."""
_OFF_PATH_M, _OFF_PATH_CRUISE_S = 10.0, 2.0
"""How far from its path: so much, and as far as cruise leads in so many seconds."""
_ANSWER_LIMIT_S = 3.0
"""A planner is asked at most so much earlier for being slow: later pictures tell it more."""
_ANSWER_MEMORY = 0.9
_STANDING_S = 0.5
"""Ways shorter than at cruise in this time are none."""
_STUCK_S = 30.0
"""Vehicle time for which the drone may make no way."""
_CLIMB_LIMIT_S = 120.0
_HEIGHT_BAND_M, _HEIGHT_BAND = 2.0, 0.15
_THERE_M = 2.0
"""So near to the end of its own way home the autopilot returns."""


class Patrol:
    """Flies until the guard ends it; `run` goes on after a pause."""

    def __init__(
        self,
        setup: FlightSetup,
        supervisor: Supervisor,
        events: EventStream,
        battery: Battery,
        *,
        frame: AreaFrame,
        profile: Profile,
        fence: Fence,
        routes: Routes,
        roadmap: Roadmap,
        start_au: FloatArray,
    ) -> None:
        self._setup = setup
        self._mission = setup.file.mission
        self._link = setup.link
        self._supervisor = supervisor
        self._events = events
        self._frame, self._profile = frame, profile
        self._fence, self._routes = fence, routes
        self._roadmap = roadmap
        self._battery, self._drag = battery, battery.drag
        history = setup.history
        self.tally = history.tally if history else None
        self._observer = Observer(setup, events, frame, battery, self.tally)
        self._peace = Peace(self._mission, frame, self._observer.belief.sightings, events)
        self._origin = setup.link.state.origin  # of the frame in which all that is laid
        self._horizon_m = self._mission.horizon_au * frame.side_m
        self._num_pictures = self._mission.num_pictures
        self._jumped_down_m = setup.link.state.jumped_down_m  # before the area was laid
        self._lower_m = 0.0  # by how much the profile is, for what the height has jumped since
        self._waypoint_au = start_au
        self._node: int | None = 0
        if history and history.waypoint_au is not None:
            self._waypoint_au, self._node = history.waypoint_au, history.node
        self._chosen_au = self._waypoint_au  # it is told of `_waypoint_au`, where the path ends
        self._last_pose: Pose | None = None
        self._waiting_since: tuple[float, float] | None = None  # vehicle and wall time
        self._is_waypoint_due = self._is_planner_asked = self._is_slowness_told = False
        self._work = asyncio.Event()  # a waypoint is due, or a picture is taken
        self._due_s = self._answer_s = 0.0  # since when it is, and how long answers took of late
        self._on_path_s = 0.0

    async def run(self) -> None:
        """Patrol from wherever the vehicle is, until the guard says to leave.

        Raises what the vehicle, the camera, the planner or the recorder raise.
        """
        self._last_pose, self._waiting_since = None, None
        self._last_setpoint_s = -math.inf
        self._is_waypoint_due = self._is_planner_asked = False
        self._observer.resume()
        self._work.set()
        place_m = self._link.pose.position_ned_m[:2]
        await self._link.start_offboard(self._setpoint(place_m))
        if not await self._come_to_height(place_m):
            return
        self._set_out(self._link.pose)
        try:
            async with asyncio.TaskGroup() as group:
                others = [
                    group.create_task(self._observer.photograph(self._work), name="photograph"),
                    group.create_task(self._watch(), name="watch"),
                ]
                await self._guide()
                for task in others:
                    task.cancel()
        except BaseExceptionGroup as group_error:
            # The first failure cancelled the others: it alone is the story.
            raise group_error.exceptions[0] from None

    # Guidance

    async def _come_to_height(self, place_m: Point) -> bool:
        """Straight up or down first: a pilot may give control back anywhere. -> whether to go on"""
        pose = self._link.pose
        limit_s = pose.time_s + _CLIMB_LIMIT_S
        while not self._is_at_height(pose):
            advice = self._supervisor.ask(
                is_outside=not self._fence.stops_inside(pose),
                is_off_path=pose.time_s > limit_s,
                is_home_around=not self._routes.are_straight,
            )
            if advice.action is not Action.GO_ON:
                return False
            await self._link.send_setpoint(self._setpoint(place_m))
            pose = await self._link.next_pose()
        self._on_path_s = self._got_there_s = pose.time_s
        return True

    def _is_inside(self, pose: Pose) -> bool:
        down_m = self._profile.down_m(pose.position_ned_m[:2])
        return self._fence.stops_inside(pose) and self._fence.is_at_height(pose, down_m)

    def _is_at_height(self, pose: Pose) -> bool:
        down_m = self._profile.down_m(pose.position_ned_m[:2]) + self._lower_m
        off_m = abs(pose.position_ned_m[2] - down_m)
        return off_m <= _HEIGHT_BAND_M + _HEIGHT_BAND * self._mission.flight.altitude_m

    def _set_out(self, pose: Pose) -> None:
        """Begin a path here, to the newest waypoint, at the height that was flown so far."""
        flight, state = self._mission.flight, self._link.state
        self._num_resets = state.num_resets
        self._lower_m = state.jumped_down_m - self._jumped_down_m
        self._carrot = Carrot(
            pose.position_ned_m[:2],
            speed_m_s=flight.cruise_speed_m_s,
            max_speed_m_s=flight.speed_limit_m_s,
            max_acceleration_m_s2=flight.turn_acceleration_m_s2,
            window_m=flight.turn_window_m,
            ground_speed_m_s=pose.ground_speed_m_s,
        )
        here_m = pose.position_ned_m[:2]
        goal_m = _point(self._frame.au_to_ned(self._waypoint_au))
        is_home = self._is_heading_home
        for place_m in self._routes.home(here_m) if is_home else self._routes.to(here_m, goal_m):
            self._carrot.extend(place_m)
        self._got_to_m = 0.0

    async def _guide(self) -> None:
        while True:
            pose = await self._link.next_pose()
            last, self._last_pose = self._last_pose, pose
            if last is not None and self.tally is not None and not self._is_heading_home:
                self.tally.move(last, pose)
            self._events.emit(Moved(pose=pose))
            duration_s = pose.time_s - self._last_setpoint_s
            if duration_s < SETPOINT_INTERVAL_S:
                continue
            if self.has_origin_moved():
                raise VehicleError("the origin of its local frame moved: the area lies elsewhere")
            was_heading_home = self._is_heading_home
            advice = self._supervisor.ask(
                is_horizon_flown=self._is_horizon_flown(),
                is_planner_late=self._is_planner_late(pose),
                is_estimate_silent=not self._link.state.is_estimate_heard,
                is_outside=not self._is_inside(pose),
                is_off_path=self._is_off_path(pose),
                is_stuck=self._is_stuck(pose),
                is_blind=self._observer.is_blind(pose.time_s),
                is_home_around=not (self._routes.are_straight or self._is_there()),
            )
            if advice.action is not Action.GO_ON:
                return
            if self._is_heading_home and not was_heading_home:
                self._head_home()
            self._last_setpoint_s = pose.time_s
            if self._link.state.num_resets != self._num_resets:
                self._events.note("position", "the estimate moved; so does the path", level="WARN")
                self._set_out(pose)
            elif not self._is_heading_home:
                time_au = self._time_au(pose.time_s)
                self._waypoint_au = self._peace.keep(self._carrot, pose, self._waypoint_au, time_au)
            self._drag.take(pose)
            motion = self._carrot.advance(
                min(duration_s, 4 * SETPOINT_INTERVAL_S), pose.position_ned_m[:2]
            )
            await self._link.send_setpoint(self._setpoint(*motion))
            if self._is_heading_home:
                self._supervisor.report("to home")
                continue
            self._ask_for_waypoint(pose)
            self._ask_for_picture(pose)
            self._supervisor.report("patrol" if self.tally else "to the start")

    @property
    def _is_heading_home(self) -> bool:
        return self._supervisor.state is State.HEADING_HOME

    def _head_home(self) -> None:
        """Leave the path for the way home."""
        self._is_waypoint_due, self._waiting_since = False, None
        for place_m in self._routes.home(self._carrot.turn_off()):
            self._carrot.extend(place_m)

    def _is_there(self) -> bool:
        """Whether all of its own way home is flown."""
        return self._is_heading_home and self._carrot.remaining_m < _THERE_M

    def has_origin_moved(self) -> bool:
        """Whether the vehicle's local frame lies elsewhere than when the area was laid."""
        then, now = self._origin, self._link.state.origin
        if then is None or now is None or now == then:
            return False
        return math.hypot(*geo_to_ned(now, then)[:2]) > ORIGIN_DOUBT_M

    def _setpoint(
        self, position_m: Point, velocity_m_s: Point = _STILL, acceleration_m_s2: Point = _STILL
    ) -> Setpoint:
        (north, east), drag = acceleration_m_s2, self._drag.per_s
        down_m, sinking_m_s = self._profile.motion(position_m, velocity_m_s)
        return Setpoint(
            position_ned_m=(*position_m, down_m + self._lower_m),
            velocity_ned_m_s=(*velocity_m_s, sinking_m_s),
            acceleration_ned_m_s2=(
                north + drag * velocity_m_s[0],
                east + drag * velocity_m_s[1],
                0.0,
            ),
            yaw_rad=self._frame.heading_rad,
        )

    def _is_horizon_flown(self) -> bool:
        """Whether all is flown and the last picture, which is due just there, is taken."""
        return (
            self.tally is not None
            and self.tally.flown_m >= self._horizon_m
            and self.tally.num_pictures_due >= self._num_pictures
            and not self._observer.is_taking
        )

    def _is_stuck(self, pose: Pose) -> bool:
        """Whether it gets no further on its path though it has somewhere to go."""
        way_m, was_at_m = _STANDING_S * self._mission.flight.cruise_speed_m_s, self._got_to_m
        if self._waiting_since is not None or self._carrot.travelled_m > was_at_m + way_m:
            self._got_to_m, self._got_there_s = self._carrot.travelled_m, pose.time_s
        return pose.time_s > self._got_there_s + _STUCK_S

    def _is_off_path(self, pose: Pose) -> bool:
        """Whether it has been far from its path or its height for long."""
        far_m = max(_OFF_PATH_M, _OFF_PATH_CRUISE_S * self._mission.flight.cruise_speed_m_s)
        if self._is_at_height(pose) and self._carrot.off_m <= far_m:
            self._on_path_s = pose.time_s
        return pose.time_s > self._on_path_s + _OFF_PATH_S

    def _is_planner_late(self, pose: Pose) -> bool:
        if self._waiting_since is None:
            return False
        since_s, since = self._waiting_since
        waited_s, waited = pose.time_s - since_s, asyncio.get_running_loop().time() - since
        if not self._is_slowness_told and waited_s > _SLOW_S and waited > _SLOW_WALL_S:
            self._is_slowness_told = True
            who = "planner" if self._is_planner_asked else "detector"
            what = f"no waypoint yet: the drone stays there for {PLANNER_LIMIT_S:g} s at most"
            self._events.note(f"{who} slow", what, level="WARN")
        return waited_s > PLANNER_LIMIT_S and waited > PLANNER_LIMIT_WALL_S

    def _ask_for_waypoint(self, pose: Pose) -> None:
        self._is_waypoint_due = self._carrot.needs_waypoint(self._answer_s)
        if not self._is_waypoint_due:
            self._waiting_since, self._is_planner_asked = None, False
            return
        if self._waiting_since is None:
            self._due_s = pose.time_s
            self._wait_from(pose)
        self._work.set()

    def _wait_from(self, pose: Pose) -> None:
        """Count from here how long there is none: it has become due, or the planner is asked."""
        self._waiting_since = pose.time_s, asyncio.get_running_loop().time()
        self._is_slowness_told = False

    def _ask_for_picture(self, pose: Pose) -> None:
        tally = self.tally
        if tally is None:
            return
        due_m = (tally.num_pictures_due + 1) * MEASUREMENT_INTERVAL_AU * self._frame.side_m
        # The nearest setpoint to the due distance is at most half a setpoint's way off.
        ahead_m = 0.5 * SETPOINT_INTERVAL_S * pose.ground_speed_m_s
        if tally.num_pictures_due < self._num_pictures and tally.flown_m + ahead_m >= due_m:
            tally.num_pictures_due += 1
            self._observer.ask()
        tally.cross_track_m.append(self._carrot.cross_track_m(pose.position_ned_m[:2]))

    # What is seen and chosen

    async def _watch(self) -> None:
        while True:
            if self._is_waypoint_due:
                if not self._is_planner_asked:
                    self._is_planner_asked = True
                    self._wait_from(self._link.pose)
                await self._choose()
                self._is_waypoint_due = False  # or the next setpoint says so again
            elif self._observer.has_unseen:
                await self._observer.look()
            else:
                self._work.clear()
                await self._work.wait()

    async def look_at_the_rest(self) -> None:
        """Look at the pictures that were taken and not yet looked at when the patrol ended."""
        await self._observer.look_at_the_rest()

    async def _choose(self) -> None:
        """Ask the planner, tell what it chose, and lengthen the path by it."""
        now_s = self._link.time_s
        if self.tally is None:
            self.tally = Tally(start_s=now_s, sightings=self._observer.belief.sightings)
            self._observer.tally = self.tally
            priors_au = self._setup.priors_au
            self._events.note("patrol", "the patrol begins", start_s=now_s, priors_au=priors_au)
        snapshot = self._snapshot(self.tally, now_s)
        num_measurements = len(snapshot.sightings)
        began = time.perf_counter()
        planner = self._setup.planner
        told_au = self._waypoint_au
        here_au = told_au if self._node is None else self._chosen_au
        asked = partial(decide, planner, snapshot, here_au, self._frame.arena)
        waypoint, weights = await in_daemon_thread(asked, f"planner '{planner.name}'", PlannerError)
        if self._is_heading_home:  # nobody flies there any more
            return
        decision_ms = (time.perf_counter() - began) * 1e3
        waypoint_au = waypoint.position_au
        self._events.emit(
            Decided(
                time_s=now_s,
                time_au=snapshot.time_au,
                flown_au=snapshot.flown_au,
                remaining_au=snapshot.remaining_au,
                position_au=told_au,
                waypoint_au=waypoint_au,
                node=waypoint.node,
                num_measurements=num_measurements,
                decision_ms=decision_ms,
                details=waypoint.details,
            )
        )
        if weights:
            self._events.emit(Attended(time_s=now_s, weights=weights))
        self.tally.decision_ms.append(decision_ms)
        took_s = min(self._link.time_s - self._due_s, _ANSWER_LIMIT_S)
        self._answer_s = max(took_s, _ANSWER_MEMORY * self._answer_s)
        end_m, time_au = self._carrot.end_m, self._time_au(self._link.time_s)
        self._waypoint_au = self._peace.lengthen(self._carrot, waypoint_au, time_au)
        if self._carrot.end_m != end_m:
            self._waiting_since, self._is_planner_asked = None, False
        self._chosen_au, self._node = waypoint_au, waypoint.node

    def _time_au(self, now_s: float) -> float:
        return self._frame.s_to_au(now_s - self.tally.start_s) if self.tally else 0.0

    def _snapshot(self, tally: Tally, now_s: float) -> Snapshot:
        """What the planner is told, as it will be at the waypoint that the drone is about to reach.

        It is asked a little before, so that the drone need not stop there. Corners are cut, so
        what is flown then is not known exactly: a picture due just after it counts as taken at it.
        """
        ahead_au = self._carrot.remaining_m / self._frame.side_m
        flown_au = tally.flown_m / self._frame.side_m + ahead_au
        due_au = until_measurement_au(flown_au)
        return Snapshot(
            time_au=self._time_au(now_s) + ahead_au,
            flown_au=flown_au + (due_au if due_au < _NEXT_PICTURE_AU else 0.0),
            position_au=self._waypoint_au.copy(),
            node=self._node,
            sightings=self._observer.belief.sightings,
            belief=self._observer.belief,
            roadmap=self._roadmap,
            remaining_au=max(self._mission.horizon_au - flown_au, 0.0),
        )


def _point(north_east_m: FloatArray) -> Point:
    return float(north_east_m[0]), float(north_east_m[1])
