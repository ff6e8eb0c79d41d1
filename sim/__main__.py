"""`python -m sim MISSION.yaml`: the simulated world, vehicle and camera in one process.

When all is up it prints one line of JSON on stdout (`camera`, `targets_au`, `truth`); logs go to
stderr. It ends on SIGTERM or SIGINT. With --parent each line on stdin is a fault, such as `gps+10`.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import logging
import os
import re
import signal
import sys
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

from dronemon.errors import MissionFileError, OptionError
from dronemon.mission import Mission
from dronemon.mission.addresses import parse_udpin
from dronemon.mission.faults import Fault
from dronemon.mission.load import find_mission, load_mission
from dronemon.vision.lens import Rectifier
from sim.camera import CameraServer
from sim.faults import (
    FaultSchedule,
    mission_faults,
    parse_camera_fault,
    parse_vehicle_fault,
)
from sim.flight import MockFlight
from sim.follow import Follower
from sim.sprites import draw_sprites
from sim.world import TruthFile, World

_LOG = logging.getLogger("sim")
_KEY_BYTES = 32


def main(arguments: list[str] | None = None) -> int:
    """Run the simulator with these or the process's arguments. -> exit status."""
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="sim: %(message)s")
    options = _parse(arguments)
    try:
        mission = load_mission(find_mission(options.mission)).mission
        with TruthFile(options.truth) as truth:
            asyncio.run(_run(mission, truth, options))
    except (MissionFileError, OptionError) as exc:
        _LOG.error("%s", exc)
        return exc.exit_code
    except OSError as exc:
        _LOG.error("%s", exc)
        return 2
    return 0


async def _run(mission: Mission, truth: TruthFile, options: argparse.Namespace) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    world = World(mission, options.walked)
    for look in set(world.looks) if mission.camera.is_simulated else ():
        draw_sprites(look)  # half a second each, which no picture is to wait for
    model, seed = mission.camera.model, mission.simulation.seed
    async with contextlib.AsyncExitStack() as stack:
        simulated: Follower | MockFlight
        if options.follow is not None:
            listed = mission_faults(mission, parse_camera_fault)
            simulated = Follower(world, options.follow, (*listed, *options.fault))
            await stack.enter_async_context(simulated)
        else:
            simulated = MockFlight(mission, world, tuple(options.fault), options.clock)
            await simulated.open_links(options.mavlink_out, options.signing_key)
            stack.callback(simulated.close_links)
        camera = CameraServer(
            model,
            seed,
            simulated.scene,
            truth.write,
            simulated.faults.active,
            Rectifier.of_mission(mission),
            mission.simulation,
        )
        if isinstance(simulated, Follower):
            vehicle = simulated.run(camera)
        else:
            vehicle = simulated.run(options.speed_up or mission.vehicle.speed_up)
        if options.parent:
            add_fault = partial(_add_fault, simulated.faults, _parser_of_faults(options))
            told = (loop, stop, add_fault)
            threading.Thread(target=_listen_to_parent, args=told, daemon=True).start()
        async with camera, asyncio.TaskGroup() as tasks:
            running = tasks.create_task(vehicle, name="vehicle")
            _announce(camera, world, truth)
            await stop.wait()
            running.cancel()
    _LOG.info("ended")


def _announce(camera: CameraServer, world: World, truth: TruthFile) -> None:
    """Say on stdout where everything is."""
    line = {
        "camera": f"tcp://127.0.0.1:{camera.port}",
        "targets_au": world.targets_au(0.0).tolist(),
        "truth": truth.path and str(truth.path),
    }
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


def _listen_to_parent(
    loop: asyncio.AbstractEventLoop, stop: asyncio.Event, add_fault: Callable[[str], None]
) -> None:
    """Take faults, line by line; stop when stdin closes, which it does when the parent is gone."""
    unread = b""
    while chunk := os.read(0, 4096):
        *lines, unread = (unread + chunk).split(b"\n")
        for line in lines:
            loop.call_soon_threadsafe(add_fault, line.decode(errors="replace").strip())
    loop.call_soon_threadsafe(stop.set)


def _add_fault(faults: FaultSchedule, parse: Callable[[str], Fault], text: str) -> None:
    try:
        faults.add(parse(text))
        _LOG.info("fault: %s", text)
    except ValueError as exc:
        _LOG.error("%s", exc)


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    """Options that fit together. A bad one ends the program with what is wrong."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.follow is None and not options.mavlink_out:
        parser.error("nobody would hear the autopilot: give --mavlink-out or --follow")
    if options.follow is not None and (
        options.mavlink_out or options.speed_up or options.signing_key or options.clock
    ):
        parser.error(
            "--follow has no autopilot: --mavlink-out, --speed-up, --signing-key, --clock do not "
            "apply"
        )
    try:
        options.fault = [_parser_of_faults(options)(text) for text in options.fault]
    except ValueError as exc:
        parser.error(f"--fault: {exc}")
    return options


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m sim", description=__doc__)
    parser.add_argument("mission", help="mission file, or the name of a shipped mission")
    parser.add_argument(
        "--mavlink-out",
        type=_address,
        action="append",
        default=[],
        metavar="IP:PORT",
        help="where the autopilot streams to; may be repeated",
    )
    parser.add_argument("--speed-up", type=_speed_up, help="times real time, 1 to 20")
    parser.add_argument("--truth", type=Path, metavar="FILE", help="write the truth there")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="KIND[=VALUE][@SECONDS][+DURATION]",
        help="at once or in vehicle seconds after arming; may be repeated; --follow: of the camera",
    )
    parser.add_argument(
        "--follow",
        type=_checked(parse_udpin),
        metavar="udpin://IP:PORT",
        help="no autopilot: world and camera follow the vehicle heard there",
    )
    parser.add_argument(
        "--signing-key",
        type=_checked(_signing_key),
        metavar="FILE",
        help="32 bytes; sign what is sent and hear only what is signed (MAVLink 2)",
    )
    parser.add_argument(
        "--clock", type=_seconds, default=0.0, help="vehicle time in s at which it begins"
    )
    parser.add_argument(
        "--walked", type=_seconds, default=0.0, help="for how long in s the animals have walked"
    )
    parser.add_argument("--parent", action="store_true", help="end when stdin closes")
    return parser


def _parser_of_faults(options: argparse.Namespace) -> Callable[[str], Fault]:
    """Reads a fault of what is simulated."""
    return parse_vehicle_fault if options.follow is None else parse_camera_fault


_T = TypeVar("_T")


def _checked(parse: Callable[[str], _T]) -> Callable[[str], _T]:
    """The parser with its error text kept, which argparse drops from a ValueError."""

    def parse_argument(text: str) -> _T:
        try:
            return parse(text)
        except ValueError as exc:
            raise argparse.ArgumentTypeError(str(exc)) from exc

    return parse_argument


def _address(text: str) -> tuple[str, int]:
    match = re.fullmatch(r"(127(?:\.\d{1,3}){3}):(\d{1,5})", text)
    if match is None or not 0 < int(match[2]) < 65536:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not IP:PORT on loopback, such as 127.0.0.1:14540"
        )
    return match[1], int(match[2])


def _signing_key(text: str) -> bytes:
    try:
        key = Path(text).read_bytes()
    except OSError as exc:
        raise ValueError(f"{text}: cannot be read: {exc}") from exc
    if len(key) != _KEY_BYTES:
        raise ValueError(f"{text} has {len(key)} bytes; a key has {_KEY_BYTES}")
    return key


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds")
    return value


def _speed_up(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1.0 <= value <= 20.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1 to 20")
    return value


if __name__ == "__main__":
    sys.exit(main())
