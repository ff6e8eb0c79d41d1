"""`dronemon view`: a flight's recording in Rerun's viewer."""

from __future__ import annotations

import contextlib
import signal
import subprocess
from typing import Annotated

import typer

from dronemon.errors import RecordError, ViewError
from dronemon.flight_options import RunArgument
from dronemon.mission.schema import View
from dronemon.recorder import RunFolder
from dronemon.terminal import console, print_warning
from dronemon.viz.page import find_viewer

_PORT = View().port
_END_TIMEOUT_S = 3.0
PortOption = Annotated[int, typer.Option(min=1024, max=65535, help="Of the data, on 127.0.0.1.")]


def view_command(run: RunArgument, port: PortOption = _PORT) -> None:
    """Look at a flight's recording: in a window, or without a display on a page of this machine."""
    show(RunFolder.open(run), port)


def show(folder: RunFolder, port: int) -> None:
    """Show a run's recordings until the window is closed or a person ends it.

    Raises RecordError, ViewError.
    """
    recordings = [folder.path / name for name in folder.recordings()]
    if not recordings:
        raise RecordError(f"{folder.path}: no recording: the flight ended before one was begun")
    for name in {path.name for path in recordings} & set(folder.damaged_files()):
        print_warning(f"{folder.path / name} is not as the flight left it")
    viewer = find_viewer(port)
    console.print(viewer.where, soft_wrap=True, markup=False)
    console.print("Ctrl-C ends it")
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    program = subprocess.Popen(
        [*viewer.command, *recordings], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        status = program.wait()
    except KeyboardInterrupt:
        program.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            program.wait(_END_TIMEOUT_S)
        return
    finally:
        program.kill()  # a busy one may not heed us, and a person may not wait: a second Ctrl-C
        program.wait()
    if status:
        raise ViewError(f"the Rerun viewer ended with status {status}")
