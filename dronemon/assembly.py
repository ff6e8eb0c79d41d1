"""How a mission becomes a flight: planner, simulator, link, camera, view, and what is flown."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import signal
from collections.abc import Callable, Coroutine, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from dronemon.camera import CropKeeper
from dronemon.card import find_checkpoint
from dronemon.connections import make_camera, make_link
from dronemon.errors import DronemonError, LinkTimeout, VehicleError
from dronemon.events import AreaLaid, Audience, TruthTold, Watcher
from dronemon.export.live import Pack, SightingSender, cot_pack, station_pack
from dronemon.feasibility import make_planner
from dronemon.mission import Mission, MissionFile
from dronemon.planner import Planner
from dronemon.preflight import Finding
from dronemon.recorder import SIMULATOR_LOG, RunFolder, RunRecorder
from dronemon.runner.flight import FlightResult, fly_mission
from dronemon.runner.history import History, Newest, read_history, read_newest
from dronemon.runner.inspection import inspect_vehicle
from dronemon.runner.interrupts import Interrupted, Interrupts
from dronemon.runner.preparation import FlightSetup, known_places_au, rehearse
from dronemon.runner.relay import Relay
from dronemon.runner.summary import Summary, summarise
from dronemon.simulator import Simulator, Truth, simulator
from dronemon.terminal import FlightDisplay, console, print_error, print_warning
from dronemon.types import FloatArray
from dronemon.vehicle.mavsdk_link import MavsdkLink
from dronemon.vision.detector import Detector
from dronemon.vision.registry import make_detector
from dronemon.viz import FlightView

_WORKER_THREADS = 16
"""MAVSDK's calls wait in them."""
_TRUTH_INTERVAL_S = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What a person asks for beside the mission.

    follow:   second MAVLink URL of a real vehicle, for simulated animals and camera to follow it
    settings: parameters of the vehicle meanwhile, by name
    out:      the run folder; a new one if None
    resume:   the run folder of a flight that is to go on, instead
    cot:      where sightings are sent while it flies, udp://HOST:PORT
    station:  of a ground station that is told of them, the same
    has_markers: whether it is to mark them on its map
    redact_m: to how many metres both are told where; 0: exactly; None: to a kilometre
    """

    follow: str | None = None
    settings: Mapping[str, float] = field(default_factory=dict)
    out: Path | None = None
    resume: Path | None = None
    cot: str | None = None
    station: str | None = None
    has_markers: bool = False
    redact_m: float | None = None


async def assemble_and_fly(
    file: MissionFile, request: Request
) -> tuple[FlightResult, Summary, RunFolder]:
    """Fly a mission that was checked with everything it names. -> result, summary, run folder

    Raises DronemonError for what fails before the flight begins; the rest is in the result.
    """
    mission = file.mission
    planner = make_planner(mission.planner)
    newest = read_newest(RunFolder.open(request.resume)) if request.resume else None
    with _recorder(mission, request) as recorder:
        try:
            console.print(f"run folder: {recorder.folder.path}", soft_wrap=True, markup=False)
            console.print("getting ready (the first time code is compiled, for about 15 s)")
            result, truth = await _with_everything(file, planner, request, recorder, newest)
        except BaseException as exc:
            # A new run whose simulator failed is kept: one is sent to its log.
            if recorder.is_empty and (request.resume or SIMULATOR_LOG not in str(exc)):
                recorder.discard()
            else:
                recorder.finish("failed", {"error": str(exc) or repr(exc)})
            raise
        sum_up = partial(summarise, mission=mission, place_of=recorder.ground_place)
        try:
            summary = sum_up(result, truth=truth)
            recorder.finish(result.outcome, {**summary.as_json(), **_weights(mission)})
        except Exception as exc:  # noqa: BLE001 - the last word on the drone comes first
            result = _failed_after(result, exc)
            summary = sum_up(replace(result, tally=None), truth=())
    return result, summary, recorder.folder


def _weights(mission: Mission) -> dict[str, object]:
    """Which checkpoint flew, if one did."""
    if mission.planner.kind != "stamp":
        return {}
    path = find_checkpoint(mission.planner.checkpoint)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return {"checkpoint": {"name": path.name, "sha256": digest}}


def _failed_after(result: FlightResult, exc: Exception) -> FlightResult:
    """The result of a flight after which something failed: how it ended stays true."""
    error = exc if isinstance(exc, DronemonError) else DronemonError(repr(exc))
    print_error(f"after the flight: {error}")
    return replace(result, error=result.error or error)


def _recorder(mission: Mission, request: Request) -> RunRecorder:
    """The record, of a new run or of one that goes on."""
    if request.resume is None:
        return RunRecorder.create(mission, out=request.out)
    return RunRecorder.resume(RunFolder.open(request.resume), mission)


def _make_threads() -> None:
    asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(_WORKER_THREADS))


def _interrupts() -> Interrupts:
    """A person's signals."""
    loop, interrupts = asyncio.get_running_loop(), Interrupts()
    wanted = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as nohup has it
        wanted.append(signal.SIGHUP)
    for signal_number in wanted:
        loop.add_signal_handler(signal_number, interrupts.request)
    return interrupts


async def _with_everything(
    file: MissionFile,
    planner: Planner,
    request: Request,
    recorder: RunRecorder,
    newest: Newest | None,
) -> tuple[FlightResult, list[TruthTold]]:
    """Open simulator, view, link and camera, fly, and close them. -> result, truth

    newest: of a run that goes on
    """
    result, truth = None, Truth(recorder.folder.path)
    try:
        async with contextlib.AsyncExitStack() as stack:
            detector, interrupts = make_detector(file.mission), _interrupts()
            _make_threads()
            rehearsal = rehearse(file.mission, detector, planner, interrupts)
            run = _Run(
                file=file,
                sim=await _start(file.mission, recorder.folder, stack, request, newest, rehearsal),
                detector=detector,
                planner=planner,
                recorder=recorder,
                audience=_open_views(file.mission, recorder.folder, request, stack),
                interrupts=interrupts,
                settings=request.settings,
                folder=recorder.folder.path,
                truth=truth,
            )
            result = await run.fly(is_resumed=newest is not None)
    except Exception as exc:
        if result is None:
            raise
        result = _failed_after(result, exc)
    assert result is not None  # or it was raised
    for what in run.audience.losses():
        print_warning(f"left out: {what}")
    return result, truth.told


def _open_views(
    mission: Mission, folder: RunFolder, request: Request, stack: contextlib.AsyncExitStack
) -> Audience:
    sent = list[Watcher]()
    to_whom: tuple[tuple[str, str | None, Callable[[AreaLaid], Pack]], ...] = (
        ("--cot", request.cot, partial(cot_pack, mission)),
        ("--station", request.station, partial(station_pack, has_markers=request.has_markers)),
    )
    for option, url, packing in to_whom:
        if url is not None:
            sender = SightingSender(url, option, mission, packing, request.redact_m)
            sent.append(stack.enter_context(sender))
            console.print(f"{option}: sightings go to {sender.where}", soft_wrap=True, markup=False)
    view = stack.enter_context(FlightView(folder.new_rrd_path(), mission))
    if view.where:
        console.print(f"live view: {view.where}", soft_wrap=True, markup=False)
    crops = stack.enter_context(CropKeeper(folder.path, mission))
    return Audience((*sent, view, crops, stack.enter_context(FlightDisplay(console))))


async def assemble_and_inspect(
    file: MissionFile, request: Request, show: Callable[[Sequence[Finding]], None]
) -> tuple[Finding, ...]:
    """Ask all that is asked before a take-off, with everything that the mission names.

    show: is shown what is found, while it is so
    Raises DronemonError where nothing can be asked.
    """
    mission = file.mission
    planner = make_planner(mission.planner)
    _make_threads()
    async with contextlib.AsyncExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="dronemon-")))
        recorder = RunRecorder.create(mission, out=folder / "run", needed_bytes=0)
        stack.enter_context(recorder)
        sim = None
        if mission.vehicle.is_mock or request.follow:
            sim = await stack.enter_async_context(simulator(folder / "run", request.follow))
        run = _Run(
            file=file,
            sim=sim,
            detector=make_detector(mission),
            planner=planner,
            recorder=recorder,
            audience=Audience(),
            interrupts=Interrupts(),
            settings=request.settings,
            folder=_existing(request.out or Path()),
            truth=Truth(recorder.folder.path),
        )
        setup = run.setup(await stack.enter_async_context(run.link()))
        tell = partial(console.print, soft_wrap=True, markup=False)
        return await inspect_vehicle(setup, tell, show)


def _existing(path: Path) -> Path:
    """The folder itself, or the one that it would be made in."""
    return next(folder for folder in (path, *path.absolute().parents) if folder.is_dir())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Run:
    """A flight, and with a fresh battery the next, until the horizon is flown.

    sim:    None where nothing is simulated
    folder: on whose disk the record must have room
    truth:  where the simulator has the targets; its audience is told, nobody else is
    """

    file: MissionFile
    sim: Simulator | None
    detector: Detector
    planner: Planner
    recorder: RunRecorder
    audience: Audience
    interrupts: Interrupts
    settings: Mapping[str, float]
    folder: Path
    truth: Truth

    def setup(self, link: MavsdkLink, history: History | None = None) -> FlightSetup:
        """What the next flight is made of."""
        return FlightSetup(
            file=self.file,
            link=link,
            camera=make_camera(self.file.mission, self.sim, link),
            detector=self.detector,
            planner=self.planner,
            priors_au=self._priors_au(),
            record=self.recorder,
            audience=self.audience,
            interrupts=self.interrupts,
            settings=self.settings,
            folder=self.folder,
            history=history,
        )

    def link(self) -> MavsdkLink:
        """A new link to the vehicle."""
        return make_link(self.file.mission, self.sim)

    async def fly(self, *, is_resumed: bool) -> FlightResult:
        """Fly. A simulator that ends meanwhile is told at once, and its vehicle not waited for."""
        ends: list[VehicleError] = []
        sim = self.sim

        async def watch(sim: Simulator) -> None:
            ends.append(await sim.ended())
            print_error(str(ends[0]))
            if sim.vehicle_url is not None:
                self.interrupts.give_up()

        tasks = [watch(sim), self._keep_telling_truth()] if sim else []
        beside = [asyncio.create_task(task, name="simulator") for task in tasks]
        try:
            result = await self._fly_on(is_resumed=is_resumed)
        finally:
            for task in beside:
                task.cancel()
        is_gone = bool(ends) and sim is not None and sim.vehicle_url is not None
        if is_gone and result.last_seen is not None:
            gone = replace(result.last_seen, what_comes="it is gone with its simulator")
            return replace(result, error=ends[0], last_seen=gone)
        return result

    async def _fly_on(self, *, is_resumed: bool) -> FlightResult:
        """Fly with one battery after the other. What fails between two is in the last result."""
        result: FlightResult | None = None
        landed: FlightResult | None = None
        while True:
            try:
                history = self._history() if is_resumed or result else None
                async with contextlib.AsyncExitStack() as stack:
                    setup = self.setup(await self._connected(stack), history)
                    result = await fly_mission(setup)
                self._tell_truth()
                landed = None if result.has_flown else landed
                if not await Relay(setup, self.link).goes_on(result, landed):
                    return result
                landed = landed or result
            except Exception as exc:
                if result is None:
                    raise
                return _failed_after(result, exc)

    async def _connected(self, stack: contextlib.AsyncExitStack) -> MavsdkLink:
        """A link, open until the stack closes. Raises LinkTimeout also where a person ends it."""
        try:
            async with self.interrupts.leaving():
                return await stack.enter_async_context(self.link())
        except Interrupted as exc:
            raise LinkTimeout("ended before a vehicle was heard; nothing was commanded") from exc

    def _history(self) -> History:
        self.recorder.flush()
        return read_history(self.recorder.folder, self.file.mission, self._priors_au())

    async def _keep_telling_truth(self) -> None:
        while True:
            await asyncio.sleep(_TRUTH_INTERVAL_S)
            self._tell_truth()

    def _tell_truth(self) -> None:
        """Tell what the simulator has written since it was asked last."""
        for told in self.truth.read_on():
            self.audience.take(told)

    def _priors_au(self) -> FloatArray:
        """Known positions of the targets. -> (N, 2) au, NaN where unknown."""
        return known_places_au(self.file.mission, self.sim.targets_au if self.sim else None)


async def _start(
    mission: Mission,
    folder: RunFolder,
    stack: contextlib.AsyncExitStack,
    request: Request,
    newest: Newest | None,
    rehearsal: Coroutine[Any, Any, None],
) -> Simulator | None:
    """Rehearse while the simulator, where there is one, starts."""
    sim: Simulator | None = None
    try:
        async with asyncio.TaskGroup() as group:
            group.create_task(rehearsal, name="rehearsal")
            if mission.vehicle.is_mock or request.follow:
                simulated = simulator(folder.path, request.follow, newest)
                sim = await stack.enter_async_context(simulated)
    except BaseExceptionGroup as group_error:
        # The first failure cancelled the other.
        raise group_error.exceptions[0] from None
    return sim
