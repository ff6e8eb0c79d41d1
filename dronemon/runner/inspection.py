"""Looks at a vehicle on the ground, and at what it is flown with: facts for the preflight table."""

from __future__ import annotations

import asyncio
import contextlib
import math
import shutil
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from pathlib import Path

from dronemon.camera import check_picture
from dronemon.errors import CameraError, DronemonError, LinkLost, VehicleError
from dronemon.fence import Fence
from dronemon.frames import AreaFrame, GeoPoint, geo_to_ned
from dronemon.guard import Reason
from dronemon.guidance import Point
from dronemon.mission import Mission, check_near, field_centre, lay_frame
from dronemon.preflight import (
    PARAMETERS,
    Facts,
    Finding,
    OwnFence,
    Relief,
    Sight,
    Verdict,
    against,
    judge,
    mending_options,
)
from dronemon.recorder import NEEDED_BYTES
from dronemon.runner.daemon import in_daemon_thread
from dronemon.runner.preparation import FlightSetup, try_detector
from dronemon.runner.relief import relief_of
from dronemon.runner.supervisor import FAILSAFE_HOLD_LIMIT_S
from dronemon.types import Picture
from dronemon.vehicle import AIRBORNE, VehicleLink, VehicleState
from dronemon.vehicle.changes import Changes
from dronemon.vehicle.fence_items import areas_of

_CAMERA_TRIES = 3
_DETECTOR_LIMIT_S = 60.0


async def aim(setup: FlightSetup) -> str | None:
    """Have the camera look down, where it hangs on a gimbal. -> what is against that

    Nothing is asked of a vehicle that is flown. Raises LinkLost.
    """
    if not setup.file.mission.camera.gimbal:
        return None
    await setup.link.next_heartbeat()  # a fresh state
    if _is_flown(setup.link.state):
        return "the vehicle is flown: its gimbal is left as it is"
    return await _problem(setup.link.point_down())


def _is_flown(state: VehicleState) -> bool:
    return state.is_armed or state.landed in AIRBORNE


async def look(setup: FlightSetup) -> Sight:
    """Compare the camera, which is open, with the mission. Raises CameraError."""
    loop = asyncio.get_running_loop()
    for attempt in range(1, _CAMERA_TRIES + 1):
        asked_at = loop.time()
        try:
            picture: Picture = await setup.camera.capture()
        except CameraError:  # it may still be waking up
            if attempt == _CAMERA_TRIES:
                raise
            continue
        break
    wait_s, now_s = loop.time() - asked_at, setup.link.time_s
    check_picture(picture, setup.file.mission.camera.model, now_s, -math.inf)
    return Sight(wait_s=wait_s, age_s=max(now_s - picture.time_s, 0.0))


def lay_area(mission: Mission, home: GeoPoint, origin: GeoPoint, ground_down_m: float) -> AreaFrame:
    """Lay the area over the ground, where the mission says, or else around home.

    origin: of the local frame

    Raises MissionFileError for a field that is far from home.
    """
    check_near(mission.area, home)
    north_m, east_m, _ = geo_to_ned(field_centre(mission.area) or home, origin)
    return lay_frame(mission, (float(north_m), float(east_m)), ground_down_m)


def home_m(link: VehicleLink) -> Point:
    """North and east of home, of a vehicle that is ready."""
    state = link.state
    assert state.home is not None  # wait_ready waited for both
    assert state.origin is not None
    north_m, east_m, _ = geo_to_ned(state.home, state.origin)
    return float(north_m), float(east_m)


def fence_around(
    mission: Mission,
    frame: AreaFrame,
    link: VehicleLink,
    margin_m: float | None = None,
) -> Fence:
    """The flight's fence; margin_m: the mission's unless it is given."""
    flight = mission.flight
    stands_m = link.pose.position_ned_m[:2]  # home is there once it is armed
    return Fence.around(
        frame,
        [home_m(link), stands_m],
        altitude_m=flight.altitude_m,
        margin_m=flight.fence_margin_m if margin_m is None else margin_m,
    )


def _relief(mission: Mission, frame: AreaFrame | None, link: VehicleLink) -> Relief | None:
    """The ground below. Raises MissionFileError where its heights are not known."""
    home, origin = link.state.home, link.state.origin
    if frame is None or home is None or origin is None:
        return None
    return relief_of(mission, frame, home, origin)


async def _own_fence(mission: Mission, frame: AreaFrame, link: VehicleLink) -> OwnFence:
    """Compare the vehicle's own fence with the flight's. Raises VehicleError."""
    areas, origin = areas_of(await link.read_fence()), link.state.origin
    assert origin is not None  # the area is laid
    num_against, num_near = (
        sum(not area.allows(fence_around(mission, frame, link, margin_m), origin) for area in areas)
        for margin_m in (0.0, None)
    )
    return OwnFence(num_areas=len(areas), num_against=num_against, num_near=num_near - num_against)


def what_is_left(setup: FlightSetup) -> Mission:
    """The mission, of a run that goes on with what is left of its horizon."""
    mission, history = setup.file.mission, setup.history
    if history is None or history.tally is None:
        return mission
    left_au = mission.horizon_au - history.tally.flown_m / mission.area.side_m
    horizon = {"horizon_au": max(left_au, 0.0), "horizon_min": None}
    return mission.model_copy(update={"flight": mission.flight.model_copy(update=horizon)})


async def find(
    setup: FlightSetup,
    sight: Sight | CameraError,
    *,
    frame: AreaFrame | None,
    unready: str | None = None,
    detector: str | None = None,
    gimbal: str | None = None,
) -> tuple[Finding, ...]:
    """What the table says of the vehicle as it is now. See Facts. Raises VehicleError.

    frame: the area as it is laid; None where it is not known where the vehicle is
    """
    link, mission = setup.link, what_is_left(setup)
    parameters = await link.read_parameters(PARAMETERS)
    away_m, own_fence = 0.0, None
    if frame is not None:
        away_m = math.dist(link.pose.position_ned_m[:2], frame.centre_ned_m)
        own_fence = await _own_fence(mission, frame, link)
    state = link.state
    facts = Facts(
        parameters=parameters,
        away_m=away_m,
        own_fence=own_fence,
        has_sticks=state.has_sticks,
        battery=state.battery,
        unready=unready,
        estimate_doubts=state.estimate_doubts,
        gps=state.gps,
        remote_id=state.remote_id,
        relief=_relief(mission, frame, link),
        sight=sight,
        gimbal=gimbal,
        range_limits_m=state.range_limits_m,
        detector=detector,
        free_bytes=shutil.disk_usage(setup.folder).free,
        needed_bytes=NEEDED_BYTES,
        hold_limit_s=FAILSAFE_HOLD_LIMIT_S,
    )
    return judge(facts, mission)


def refusal(findings: Sequence[Finding], run: Path | None = None) -> VehicleError | None:
    """Why the flight must not begin, and the options that mend it; None if it may.

    run: the folder of a run that goes on
    """
    reasons = against(findings, Verdict.NO_GO)
    if not reasons:
        return None
    what = "no-go: " + "; ".join(map(str, reasons))
    if options := mending_options(reasons):
        going_on = f"--resume {run} " if run else ""
        what += f"\nfor one flight, the same command with: {going_on}{options}"
    return VehicleError(what)


async def _problem(step: Awaitable[object]) -> str | None:
    """What a step fails with, in words; a silent link is no finding."""
    try:
        await step
    except LinkLost:
        raise
    except DronemonError as exc:
        return str(exc)
    return None


async def inspect_vehicle(
    setup: FlightSetup,
    tell: Callable[[str], None],
    show: Callable[[Sequence[Finding]], None],
) -> tuple[Finding, ...]:
    """All that is asked before a take-off, without one; settings are put back in the end.

    tell: is told in words what is changed on the vehicle; show: what is found, while it is so
    Raises DronemonError where nothing can be asked, such as LinkLost.
    """
    mission, link = setup.file.mission, setup.link
    try_it = partial(try_detector, mission, setup.detector)
    tried = in_daemon_thread(try_it, "the detector", CameraError, _DETECTOR_LIMIT_S)
    detector = await _problem(tried)
    unready = await _problem(link.wait_ready(mission.vehicle.ready_timeout_s))
    await link.next_heartbeat()  # a fresh state
    is_flown = _is_flown(link.state)
    unready = str(Reason.NOT_OURS) if is_flown else unready
    async with contextlib.AsyncExitStack() as stack:
        changes = stack.enter_context(Changes(link, tell))
        if not is_flown:
            await changes.put_back()
            stack.push_async_callback(changes.put_back)
            await changes.make(setup.settings)
        gimbal = await aim(setup)
        sight: Sight | CameraError
        try:
            await stack.enter_async_context(setup.camera)
            sight = await look(setup)
        except CameraError as exc:
            sight = exc
        frame = None
        home, origin = link.state.home, link.state.origin
        if home and origin and not unready:
            frame = lay_area(mission, home, origin, link.pose.position_ned_m[2])
        findings = await find(
            setup, sight, frame=frame, unready=unready, detector=detector, gimbal=gimbal
        )
        show(findings)
        return findings
