"""Where a flight is: its area over the ground, and the fence around it."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from dronemon.errors import VehicleError
from dronemon.events import AreaLaid, EventStream
from dronemon.fence import Fence
from dronemon.frames import AreaFrame, GeoPoint
from dronemon.mission import Mission
from dronemon.roadmap import Roadmap
from dronemon.runner.inspection import fence_around, lay_area
from dronemon.runner.preparation import FlightSetup
from dronemon.runner.profile import Profile
from dronemon.runner.relief import ground_of, profile_over
from dronemon.vehicle.changes import Changes
from dronemon.vehicle.fence_items import FenceItem, are_alike, polygon_items

_POSES = 20
"""Whose mean height is the ground's."""
_HEIGHT_DOUBT_M = 5.0


class Ground:
    """Lays the area and the fence of a flight; one that goes on in the air has both.

    is_attached: to a vehicle in the air
    """

    def __init__(
        self, setup: FlightSetup, events: EventStream, changes: Changes, *, is_attached: bool
    ) -> None:
        self._mission, self._link, self._history = setup.file.mission, setup.link, setup.history
        self._events, self._changes, self._is_attached = events, changes, is_attached
        self._has_fence = True

    async def lay_area(self) -> AreaFrame:
        """Lay the square over the ground, where it lay if the run goes on.

        Its height is what the vehicle reads standing on it. Raises VehicleError where it is not
        known in the air.
        """
        link, history = self._link, self._history
        laid = history.laid if history else None
        board = None if self._mission.vehicle.is_mock else link.state.hardware  # each mock's is new
        is_same_clock = history is not None and history.go_over_to(link.time_s, board)
        if history is not None and history.newest.is_clock_behind():
            taken = "what the vehicle's own clock shows" if is_same_clock else "0 s"
            what = (
                "this machine's clock is behind that of the run: the time in between is unknown, "
                f"and taken as {taken}; for what was seen to age by it, end the program, set the "
                "clock, then resume"
            )
            self._events.note("clock", what, level="WARN")
        origin = link.state.origin
        if laid and is_same_clock and origin and laid.holds_with(origin):
            return laid.frame
        if self._is_attached:
            raise VehicleError(
                "where its area lies is not known in the air: the vehicle has rebooted since, is "
                "another one, or the run had not come so far; land it, then resume"
            )
        if history is not None and history.is_other(board):
            self._events.note("vehicle", "another one than flew this run so far", level="WARN")
        downs_m = [(await link.next_pose()).position_ned_m[2] for _ in range(_POSES)]
        state = link.state
        assert state.home is not None  # wait_ready waited for both
        assert state.origin is not None
        around = laid.centre if laid else state.home
        return lay_area(self._mission, around, state.origin, float(np.mean(downs_m)))

    def lay_profile(self, frame: AreaFrame) -> Profile:
        """How high the patrol is over each place.

        Raises MissionFileError for a terrain that does not cover it, VehicleError for one that is
        laid at another height than the vehicle, on the ground, says of itself.
        """
        state = self._link.state
        assert state.home is not None  # wait_ready waited for both
        assert state.origin is not None
        ground = ground_of(self._mission, frame, state.home, state.origin)
        if self._mission.flight.follow_terrain and not self._is_attached:
            *here_m, down_m = self._link.pose.position_ned_m
            up_m = float(ground.down_m(np.array(here_m))) - down_m
            if not abs(up_m) <= _HEIGHT_DOUBT_M:
                raise VehicleError(
                    f"by what the vehicle says of its height, it stands {up_m:+.0f} m above the"
                    " ground of area.terrain: hills are not where they seem; take off from where"
                    " this run began, or begin another"
                )
        return profile_over(ground, self._mission, frame, state.origin)

    async def lay_fence(self, frame: AreaFrame) -> Fence:
        """Have the vehicle keep the fence that the guard keeps, or in the air see that it does."""
        link, history = self._link, self._history
        fence, origin = fence_around(self._mission, frame, link), link.state.origin
        assert origin is not None  # wait_ready waited for it
        if not self._is_attached:
            await self._changes.lay_fence(polygon_items(fence.corners_deg(origin)))
            return fence
        assert history is not None  # else it would not be attached,
        assert history.laid is not None  # nor without an area
        laid = fence.laid_as(history.laid.fence_ned_m)
        self._has_fence = await self._is_kept(polygon_items(laid.corners_deg(origin)))
        return laid

    async def _is_kept(self, items: tuple[FenceItem, ...]) -> bool:
        """Whether the vehicle has a fence, ours first; if not, or it does not say, tell so."""
        try:
            has = await self._link.read_fence()
            problem = "" if are_alike(has[: len(items)], items) else "it has another one, or none"
        except VehicleError as exc:
            problem = str(exc)
        if problem:
            what = f"it does not keep the flight's fence, this program alone does: {problem}"
            self._events.note("fence", what, level="WARN")
        return not problem

    def tell(self, frame: AreaFrame, fence: Fence, roadmap: Roadmap) -> None:
        """Tell of the area; the line of it has what a flight that goes on needs to know."""
        origin = self._link.state.origin
        assert origin is not None  # as above
        laid = area_laid(self._mission, frame, origin, fence, roadmap, self._link.system_id)
        text = "the vehicle is ready" + (", and has the flight's fence" if self._has_fence else "")
        tell_laid(self._events, laid, text, self._link.state.hardware)


def area_laid(
    mission: Mission,
    frame: AreaFrame,
    origin: GeoPoint,
    fence: Fence,
    roadmap: Roadmap,
    system_id: int,
) -> AreaLaid:
    """What is told once the area is laid."""
    return AreaLaid(
        system_id=system_id,
        area=frame,
        origin=origin,
        footprint_radius_m=mission.sensor_radius_m,
        fence_ned_m=fence.corners_ned_m,
        nodes_au=roadmap.nodes_au,
        edges=np.argwhere(roadmap.edge_lengths_au.toarray() > 0),
    )


def tell_laid(events: EventStream, laid: AreaLaid, text: str, hardware: str | None) -> None:
    """Tell of the area; the line of it has what `Laid` reads.

    hardware: the vehicle's board, None if it does not say
    """
    events.emit(laid)
    events.note(
        "ready",
        text,
        frame=asdict(laid.area),
        origin=asdict(laid.origin),
        hardware=hardware,
        fence_ned_m=laid.fence_ned_m,
    )
