"""`dronemon calibrate latency`: how old a camera's pictures are when they arrive, measured."""

from __future__ import annotations

import asyncio
from typing import Annotated

import numpy as np
import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from dronemon.camera import FrameSource
from dronemon.connections import watching
from dronemon.errors import OptionError
from dronemon.feasibility import load_checked
from dronemon.flight_options import NamedMission, VehicleUrl
from dronemon.mission import Mission
from dronemon.terminal import console, print_warning
from dronemon.types import FloatArray, Picture, Pose
from dronemon.vehicle import VehicleLink
from dronemon.vision.turning import Latency, latency_of, turn_between

_GOOD_ERROR_S = 0.02
_RATE_HZ = 15.0
"""Pictures a second that are compared at most; more turn too little from one to the next."""

SecondsOption = Annotated[
    float, typer.Option(min=10.0, max=600.0, help="How long it is turned, in s.")
]


def latency_command(
    mission: NamedMission = None, vehicle: VehicleUrl = None, seconds: SecondsOption = 30.0
) -> None:
    """Measure how old pictures are when they arrive, for camera.latency_s.

    Turn the drone about its vertical axis meanwhile, to and fro by some 30 degrees, once in two
    seconds or so, unevenly: in your hands over textured ground with the propellers off, or by the
    sticks in a hover. Nothing is commanded.
    """
    if mission is None:
        raise OptionError("--mission: name the mission whose vehicle and camera are to be measured")
    overrides = {} if vehicle is None else {("vehicle", "url"): ("--vehicle", vehicle)}
    flown = load_checked(mission, overrides, None).mission
    _check_measurable(flown, mission)

    async def measure() -> Latency:
        async with watching(flown) as (link, camera):
            return await _measure(link, camera, flown.camera.latency_s, seconds)

    found = asyncio.run(measure())
    console.print(
        f"camera: {{latency_s: {found.latency_s:.3f}}}  # +- {found.error_s:.3f} s standard error; "
        f"{found.num_pairs} pairs of pictures, agreement {found.agreement:.3f}",
        soft_wrap=True,
        markup=False,
        highlight=False,
    )
    if found.error_s > _GOOD_ERROR_S:
        print_warning(
            f"more than {_GOOD_ERROR_S:g} s of error is a lot: turn it faster, for longer"
        )


def _check_measurable(mission: Mission, file: str) -> None:
    """Raises OptionError where turns of pictures and vehicle would not tell the delay."""
    if mission.vehicle.is_mock or mission.camera.is_simulated:
        raise OptionError(
            "a camera of your own on a vehicle of your own is measured: set camera.url in "
            f"{file}, and vehicle.url there or --vehicle"
        )
    if mission.camera.gimbal:
        raise OptionError(
            "camera.gimbal: a gimbal turns later than the drone, which would be taken for delay; "
            "measure with the camera fixed to the drone, and camera.gimbal left out"
        )


async def _measure(
    link: VehicleLink, camera: FrameSource, latency_s: float, duration_s: float
) -> Latency:
    """latency_s: that the camera's stamps reckon with already."""
    poses: list[Pose] = []

    async def listen() -> None:
        while True:
            poses.append(await link.next_pose())

    try:
        async with asyncio.TaskGroup() as group:
            listening = group.create_task(listen(), name="poses")
            arrived_s, turns_rad = await _photograph(link, camera, latency_s, duration_s)
            listening.cancel()
    except BaseExceptionGroup as group_error:
        raise group_error.exceptions[0] from None
    return latency_of(
        arrived_s,
        turns_rad,
        np.array([pose.time_s for pose in poses]),
        np.array([pose.attitude_rad[2] for pose in poses]),
    )


async def _photograph(
    link: VehicleLink, camera: FrameSource, latency_s: float, duration_s: float
) -> tuple[FloatArray, FloatArray]:
    """When the pictures of each pair came, and the turn between them. -> (P, 2), (P,)"""
    arrived_s, turns_rad = list[tuple[float, float]](), list[float]()
    start_s = link.time_s
    last: Picture | None = None
    columns = TextColumn("turn it to and fro"), BarColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("", total=duration_s)
        while (gone_s := link.time_s - start_s) < duration_s:
            progress.update(bar, completed=gone_s)
            picture = await camera.capture()
            if last is not None and picture.time_s - last.time_s < 1.0 / _RATE_HZ:
                continue
            if last is not None:
                turn_rad = await asyncio.to_thread(turn_between, last.image, picture.image)
                if turn_rad is not None:
                    arrived_s.append((last.time_s + latency_s, picture.time_s + latency_s))
                    turns_rad.append(turn_rad)
            last = picture
    return np.array(arrived_s).reshape(-1, 2), np.array(turns_rad)
