"""`dronemon report`: its options and their help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dronemon.durable import replace_text
from dronemon.errors import OptionError, writing
from dronemon.flight_options import RedactOption, RunArgument
from dronemon.recorder import RunFolder
from dronemon.report.figures import draw_map, save_png
from dronemon.report.flight import read_flight
from dronemon.report.page import page
from dronemon.runner.history import understanding
from dronemon.terminal import print_path

OutOption = Annotated[
    Path | None,
    typer.Option(help="The HTML file; the map goes beside it as PNG.", show_default="in RUN"),
]


def report_command(run: RunArgument, out: OutOption = None, redact: RedactOption = None) -> None:
    """Make a page of a flight for people: one HTML file without a network, and a map.

    It says exactly where each target was: --redact METRES before it is handed on.
    """
    path = run / "report.html" if out is None else out
    if path.suffix != ".html":
        raise OptionError(f"--out {path}: give a name that ends with .html")
    picture = path.with_suffix(".png")
    if picture.exists() and not path.exists():
        raise OptionError(f"--out {path}: {picture} is there already; choose another name")
    flight = read_flight(RunFolder.open(run), 0.0 if redact is None else redact)
    with understanding(flight.folder):
        told = page(flight)
    with writing("--out", path):
        replace_text(path, told)
        save_png(draw_map(flight), picture)
    print_path(path)
    print_path(picture)
