"""`dronemon view`: a flight's recording in Rerun's viewer."""

from __future__ import annotations

import contextlib
import subprocess
from typing import Annotated

import typer

from dronemon.errors import RecordError, ViewError
from dronemon.flight_options import RunArgument
from dronemon.mission.schema import View
from dronemon.recorder import RunFolder
from dronemon.terminal import console
from dronemon.viz.page import find_viewer

_PORT = View().port
PortOption = Annotated[int, typer.Option(min=1024, max=65535, help="Of the data, on 127.0.0.1.")]


def view_command(run: RunArgument, port: PortOption = _PORT) -> None:
    """Look at a flight's recording: in a window, or without a display on a page of this machine."""
    show(RunFolder.open(run), port, "choose another --port")


def show(folder: RunFolder, port: int, other_port: str) -> None:
    """Show a run's recordings until the window is closed or a person ends it.

    other_port: how to choose another one, for the error. Raises RecordError, ViewError.
    """
    recordings = [folder.path / name for name in folder.recordings()]
    if not recordings:
        raise RecordError(f"{folder.path}: no recording: the flight ended before one was begun")
    viewer = find_viewer(port, other_port)
    console.print(f"{viewer.where}; Ctrl-C ends it", soft_wrap=True, markup=False)
    program = subprocess.Popen(
        [*viewer.command, *recordings], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    with contextlib.suppress(KeyboardInterrupt):
        if status := program.wait():
            raise ViewError(f"the Rerun viewer ended with status {status}")
    program.wait()  # Ctrl-C is for it, too
