"""What a mission is flown with, and a rehearsal of it before anything moves."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import torch

from dronemon.belief import Belief, Matern32
from dronemon.belief.compiled import is_ready as belief_is_compiled
from dronemon.camera import FrameSource
from dronemon.errors import CameraError, DronemonError, PlannerError, blaming
from dronemon.events import Audience, Subscriber
from dronemon.mission import Mission, MissionFile, mission_arena
from dronemon.planner import Briefing, Explaining, Planner, Snapshot
from dronemon.roadmap import Roadmap
from dronemon.runner.daemon import in_daemon_thread
from dronemon.runner.history import History
from dronemon.runner.interrupts import Interrupted, Interrupts
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Measurement, Pose
from dronemon.vehicle import VehicleLink
from dronemon.vision.detector import Detector, look
from dronemon.world import Instance
from dronemon.world.instance import named_stream

LOOK_LIMIT_S = 3.0
"""Wall time for the detector, of each picture in flight."""
_COMPILE_LIMIT_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightSetup:
    """Everything that one flight is made of.

    link: connected; camera: still to be opened; record: the critical subscriber of what happens.

    priors_au: (N, 2) au known positions of the targets, NaN where unknown
    settings:  parameters of the vehicle for this flight, put back after it
    folder:    where the record goes
    history:   of the run that goes on, if one does
    """

    file: MissionFile
    link: VehicleLink
    camera: FrameSource
    detector: Detector
    planner: Planner
    priors_au: FloatArray
    record: Subscriber
    audience: Audience
    interrupts: Interrupts
    settings: Mapping[str, float] = field(default_factory=dict)
    folder: Path = Path()
    history: History | None = None


_SWITCH_S = 0.0005
"""How long one thread may keep the interpreter from another: at Python's 5 ms a decision of 20 ms
takes 70 beside 300 setpoints a second, at this 50."""


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
_LARGE_BYTES = 1 << 18


def _return_memory() -> None:
    """Have memory of pictures, when it is freed, go back to the system at once.

    glibc keeps more and more of it after the first one: 5 % of the program in four hours of flight.
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library
        for threshold in (_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD):
            ctypes.CDLL(None).mallopt(threshold, _LARGE_BYTES)


async def rehearse(
    mission: Mission, detector: Detector, planner: Planner, interrupts: Interrupts
) -> None:
    """Look, believe and plan once with throw-away data, so that nothing is loaded in flight.

    Compiled code is loaded at its first call, after the installation even compiled, and holds up
    everything else meanwhile, the stream of setpoints too. Needs no vehicle. Ends at once when a
    person interrupts. Raises PlannerError, or CameraError for a detector that fails.
    """
    with contextlib.suppress(Interrupted):  # the flight, which comes next, tells and ends
        async with interrupts.leaving():
            await in_daemon_thread(
                partial(_rehearse, mission, detector, planner), "the rehearsal", DronemonError
            )


def _rehearse(mission: Mission, detector: Detector, planner: Planner) -> None:
    torch.set_num_threads(1)
    sys.setswitchinterval(_SWITCH_S)
    _return_memory()
    who = f"in a rehearsal, planner '{planner.name}'"
    num_targets = len(mission.targets)
    start_au, roadmap = draw_start_and_roadmap(mission)
    # Known, or a planner may have nothing to plan yet and load nothing.
    priors_au = np.tile(start_au, (num_targets, 1))
    measurement = Measurement(
        time_au=0.1,
        agent_au=start_au,
        seen=np.zeros(num_targets, dtype=np.bool_),
        target_au=np.full((num_targets, 2), np.nan),
    )
    belief = make_belief(mission, Sightings(priors_au, mission.sensor.model))
    belief.sightings.add(measurement)
    with _belief_compiled_beside():
        try_detector(mission, detector)
        with blaming(who, PlannerError):
            planner.reset(brief(mission, priors_au, start_au, stream="rehearsal"), roadmap)
    grid_au = mission_arena(mission).grid(2)
    belief.posterior(np.concatenate([grid_au, np.full((len(grid_au), 1), 0.1)], axis=-1))
    snapshot = Snapshot(
        time_au=0.1,
        flown_au=0.1,
        position_au=start_au,
        node=0,
        sightings=belief.sightings,
        belief=belief,
        roadmap=roadmap,
        remaining_au=mission.horizon_au,
    )
    with blaming(who, PlannerError):
        planner.next_waypoint(snapshot)
        if isinstance(planner, Explaining):
            planner.explanation()
    # Searching all that is loaded by now for garbage takes 150 ms: more than many a decision.
    gc.collect()
    gc.freeze()


def try_detector(mission: Mission, detector: Detector) -> None:
    """Detect nothing in a picture of noise, twice.

    Raises CameraError for a detector that fails, or is too slow once it is warm.
    """
    camera = mission.camera.model
    level = Pose.level(mission.flight.altitude_m)
    noise = np.random.default_rng(0).integers(0, 255, (camera.height_px, camera.width_px, 3))
    image = noise.astype(np.uint8)
    image.flags.writeable = False
    look(detector, image, level, 0.0)
    began_s = time.monotonic()
    look(detector, image, level, 0.0)
    took_s = time.monotonic() - began_s
    if took_s > 0.5 * LOOK_LIMIT_S:
        raise CameraError(
            f"the detector takes {took_s:.1f} s a picture; it has {LOOK_LIMIT_S:g} s in flight, "
            "where more goes on beside it: take a smaller network, or larger tiles"
        )


@contextlib.contextmanager
def _belief_compiled_beside() -> Iterator[None]:
    """Have what beliefs need compiled on a core of its own, unless it is, until the body ends."""
    if belief_is_compiled():
        yield
        return
    compiler = subprocess.Popen(
        [sys.executable, "-P", "-m", "dronemon.belief"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,  # if it fails, the same happens here next, and is told
    )
    try:
        yield
        with contextlib.suppress(subprocess.TimeoutExpired):
            compiler.wait(_COMPILE_LIMIT_S)
    finally:
        compiler.kill()
        compiler.wait()


def draw_start_and_roadmap(mission: Mission) -> tuple[FloatArray, Roadmap]:
    """Where the patrol begins, (2,) au, and the roadmap that contains this place."""
    seed, arena = mission.simulation.seed, mission_arena(mission)
    start_au = (
        np.array(mission.flight.start_au)
        if mission.flight.start_au is not None
        else Instance.draw(seed, len(mission.targets), arena=arena).start_au
    )
    roadmap = Roadmap.random(
        mission.roadmap.num_nodes,
        mission.roadmap.num_neighbours,
        named_stream(seed, "roadmap"),
        start_au,
        arena,
    )
    return start_au, roadmap


def known_places_au(mission: Mission, simulated_au: FloatArray | None) -> FloatArray:
    """Where the mission's targets are at first. -> (N, 2) au, NaN where that is not known.

    simulated_au: (N, 2) where the simulator has them, None where there is none to ask
    """
    places_au = np.full((len(mission.targets), 2), np.nan)
    for index, target in enumerate(mission.targets):
        if target.prior_au != "simulated":
            places_au[index] = target.prior_au or np.nan
        elif simulated_au is not None:
            places_au[index] = simulated_au[index]
    return places_au


def brief(
    mission: Mission,
    priors_au: FloatArray,
    start_au: FloatArray,
    *,
    stream: str,
    sightings: Sightings | None = None,
) -> Briefing:
    """What the planner is told; its randomness is the mission's stream of this name."""
    return Briefing(
        num_targets=len(mission.targets),
        priors_au=priors_au.copy(),
        start_au=start_au.copy(),
        horizon_au=mission.horizon_au,
        rng=named_stream(mission.simulation.seed, stream),
        arena=mission_arena(mission),
        sensor=mission.sensor.model,
        sightings=sightings,
    )


def make_belief(mission: Mission, sightings: Sightings) -> Belief:
    """What was seen, as beliefs."""
    return Belief(sightings, mission_kernel(mission))


def mission_kernel(mission: Mission) -> Matern32:
    """The kernel that a mission asks for."""
    belief = mission.belief
    return Matern32(
        length_scales_au=(belief.length_scale_au, belief.length_scale_au, belief.time_scale_au)
    )
