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
from dronemon.frames import GeoPoint, geo_to_ned
from dronemon.mission import Mission
from dronemon.preflight import (
    PARAMETERS,
    Facts,
    Finding,
    Sight,
    Verdict,
    against,
    judge,
    mending_options,
)
from dronemon.recorder import NEEDED_BYTES
from dronemon.runner.daemon import in_daemon_thread
from dronemon.runner.preparation import FlightSetup, try_detector
from dronemon.runner.supervisor import FAILSAFE_HOLD_LIMIT_S
from dronemon.types import Picture
from dronemon.vehicle import VehicleState
from dronemon.vehicle.changes import Changes

_CAMERA_TRIES = 3
_DETECTOR_LIMIT_S = 60.0


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


def centre_ned_m(mission: Mission, state: VehicleState) -> tuple[float, float]:
    """Where the area's centre is, north and east; home and origin must be known."""
    area = mission.area
    assert state.home is not None  # wait_ready waited for both
    assert state.origin is not None
    centre = state.home
    if area.latitude_deg is not None and area.longitude_deg is not None:
        centre = GeoPoint(latitude_deg=area.latitude_deg, longitude_deg=area.longitude_deg)
    north_m, east_m, _ = geo_to_ned(centre, state.origin)
    return float(north_m), float(east_m)


async def find(
    setup: FlightSetup,
    sight: Sight | CameraError,
    *,
    away_m: float,
    unready: str | None = None,
    detector: str | None = None,
) -> tuple[Finding, ...]:
    """What the table says of the vehicle as it is now. See Facts. Raises LinkLost."""
    parameters = await setup.link.read_parameters(PARAMETERS)
    state = setup.link.state
    facts = Facts(
        parameters=parameters,
        away_m=away_m,
        has_sticks=state.has_sticks,
        battery=state.battery,
        unready=unready,
        estimate_doubts=state.estimate_doubts,
        gps=state.gps,
        remote_id=state.remote_id,
        sight=sight,
        detector=detector,
        free_bytes=shutil.disk_usage(setup.folder).free,
        needed_bytes=NEEDED_BYTES,
        hold_limit_s=FAILSAFE_HOLD_LIMIT_S,
    )
    return judge(facts, setup.file.mission)


def refusal(findings: Sequence[Finding], mission: Path) -> VehicleError | None:
    """Why the flight must not begin, and the command that mends it; None if it may."""
    reasons = against(findings, Verdict.NO_GO)
    if not reasons:
        return None
    options = mending_options(reasons)
    mend = f"\nfor this flight: dronemon fly {mission} {options}" if options else ""
    return VehicleError("no-go: " + "; ".join(map(str, reasons)) + mend)


async def _problem(step: Awaitable[object]) -> str | None:
    """What a step fails with, in words; a silent link is no finding."""
    try:
        await step
    except LinkLost:
        raise
    except DronemonError as exc:
        return str(exc)
    return None


async def inspect_vehicle(setup: FlightSetup, tell: Callable[[str], None]) -> tuple[Finding, ...]:
    """All that is asked before a take-off, without one; settings are put back in the end.

    tell: is told in words what is changed on the vehicle. Raises DronemonError where nothing can be
    asked, such as LinkLost.
    """
    mission, link = setup.file.mission, setup.link
    try_it = partial(try_detector, mission, setup.detector)
    tried = in_daemon_thread(try_it, "the detector", CameraError, _DETECTOR_LIMIT_S)
    detector = await _problem(tried)
    unready = await _problem(link.wait_ready(mission.vehicle.ready_timeout_s))
    changes = Changes(link, tell)
    await changes.put_back()
    try:
        await changes.make(setup.settings)
        async with contextlib.AsyncExitStack() as stack:
            sight: Sight | CameraError
            try:
                await stack.enter_async_context(setup.camera)
                sight = await look(setup)
            except CameraError as exc:
                sight = exc
            state = link.state
            away_m = 0.0
            if state.home and state.origin:
                home_m = geo_to_ned(state.home, state.origin)[:2]
                away_m = math.dist(map(float, home_m), centre_ned_m(mission, state))
            return await find(setup, sight, away_m=away_m, unready=unready, detector=detector)
    finally:
        await changes.put_back()
