"""`dronemon export`: its options and their help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dronemon.errors import OptionError, writing
from dronemon.export.formats import FORMATS, write_all
from dronemon.export.story import read_story, redacted
from dronemon.flight_options import RedactOption, RunArgument
from dronemon.recorder import RunFolder
from dronemon.terminal import console, print_path

ToOption = Annotated[Path, typer.Option("--to", help="Folder for the files.", show_default=False)]


def export_command(run: RunArgument, to: ToOption, redact: RedactOption = None) -> None:
    """Write a flight's sightings and track for maps: GeoJSON, CSV, KMZ, GPX, Cursor-on-Target."""
    story = read_story(RunFolder.open(run))
    if redact is not None:
        story = redacted(story, redact)
    if taken := [name for name in FORMATS if (to / name).exists()]:
        raise OptionError(f"--to {to}: already holds {', '.join(taken)}; choose another folder")
    with writing("--to", to):
        written = write_all(story, to)
    for path in written:
        print_path(path)
    num_targets = len({sighting.target for sighting in story.sightings})
    told = {"sighting": len(story.sightings), "target": num_targets, "place": len(story.track)}
    seen, targets, places = (f"{n} {word}{'' if n == 1 else 's'}" for word, n in told.items())
    console.print(f"{seen} of {targets}, {places} of the drone", highlight=False)
