"""`dronemon picture`: a flight at one moment, as Figures 1 and 6 of the paper show it."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Circle

from dronemon.arena import Arena
from dronemon.errors import OptionError, writing
from dronemon.flight_options import RunArgument
from dronemon.palette import belief_rgb, on_paper
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.recorder import RunFolder
from dronemon.report.flight import Flight, beliefs_at, read_flight
from dronemon.runner.summary import truth_at
from dronemon.simulator import read_truth
from dronemon.terminal import print_path
from dronemon.types import FloatArray, ImageArray
from dronemon.viz.recorded import Marked, picture_of

ToOption = Annotated[
    Path, typer.Option("--to", help="The picture: PNG, SVG or PDF.", show_default=False)
]
AtOption = Annotated[
    float | None, typer.Option(min=0.0, help="When, in au of patrol.", show_default="the end")
]
_TRAIL = 40
"""Pictures' places that the way flown fades over."""


def picture_command(run: RunArgument, to: ToOption, at: AtOption = None) -> None:
    """Draw beliefs, way flown, truth, distances and the camera's picture at one moment."""
    folder = RunFolder.open(run)
    flight = read_flight(folder)
    times_au = flight.times_s / flight.mission.seconds_per_au
    if at is not None and at > times_au[-1]:
        raise OptionError(f"--at {at:g}: the last picture is of {times_au[-1]:.1f} au")
    count = len(times_au) if at is None else max(1, int(np.searchsorted(times_au, at, "right")))
    figure = draw(folder, flight, count)
    if to.suffix.removeprefix(".") not in figure.canvas.get_supported_filetypes():
        raise OptionError(f"--to {to}: give a name that ends with .png, .svg or .pdf")
    with writing("--to", to):
        figure.savefig(to, dpi=150)
    print_path(to)


def _truth_au(folder: RunFolder) -> FloatArray | None:
    """(T, N, 2) where the targets truly were, None where no simulator told."""
    times_s = (line["time_s"] for line in folder.observations())
    return truth_at(read_truth(folder.path), times_s)


def draw(folder: RunFolder, flight: Flight, count: int) -> Figure:
    """The moment of the `count`-th picture. Source of the arrangement: paper, Figures 1 and 6."""
    mean, std = beliefs_at(folder, flight.mission, count)
    truth_au, arena = _truth_au(folder), flight.frame.arena
    columns = max(4, len(flight.names))
    figure = Figure(figsize=(2.6 * columns, 5.6), layout="constrained")
    grid = figure.add_gridspec(2, 4 * columns)
    for number, name in enumerate(flight.names):
        panel = figure.add_subplot(grid[0, 4 * number : 4 * number + 4])
        _show(panel, arena, mean[number], f"belief of {name}")
    together, truth, camera, far = (
        figure.add_subplot(grid[1, k * columns : (k + 1) * columns]) for k in range(4)
    )
    _show(together, arena, belief_rgb(mean, std), "all beliefs, and the way flown")
    _draw_way(together, flight, count)
    _frame(
        truth, arena, "where the targets truly are" + (": not known" if truth_au is None else "")
    )
    if truth_au is not None:
        _draw_areas(truth, truth_au[count - 1])
    recordings = [folder.path / name for name in folder.recordings()]
    _draw_picture(camera, picture_of(recordings, count))
    _draw_distances(far, flight, count, flight.seen_au if truth_au is None else truth_au)
    return figure


def _draw_way(panel: Axes, flight: Flight, count: int) -> None:
    """The way flown, the newest part brightest; the drone, what it sees, and whom."""
    way_au = flight.agent_au[max(0, count - _TRAIL) : count]
    legs = np.stack([way_au[:-1], way_au[1:]], axis=1)
    if len(legs):
        ages = np.linspace(0.1, 1.0, len(legs))
        trail = LineCollection(list(legs), colors="white", alpha=ages, linewidths=2.5 * ages)
        panel.add_collection(trail)
    panel.plot(*way_au[-1], "o", color="cyan", markersize=5)
    _ring(panel, way_au[-1], color="gold")  # how far it sees
    for number in np.flatnonzero(flight.seen[count - 1]).tolist():
        panel.plot(*flight.seen_au[count - 1, number], "s", color=on_paper(number), markersize=7)


def _draw_areas(panel: Axes, targets_au: FloatArray) -> None:
    """The targets, and the areas over which Unc is taken."""
    for number, target_au in enumerate(targets_au):
        panel.plot(*target_au, "s", color=on_paper(number), markersize=6)
        _ring(panel, target_au, color=on_paper(number), linestyle=":")


def _draw_picture(panel: Axes, picture: Marked | None) -> None:
    """What the camera saw, a square round each target found; the edge of the drone's sight."""
    panel.set_xticks([])
    panel.set_yticks([])
    if picture is None:
        panel.set_title("camera: not recorded", fontsize=9)
        return
    image = imread(BytesIO(picture.jpeg), format="jpg")
    panel.imshow(image)
    panel.plot(*picture.footprint_px.T, color="gold", linewidth=1.0)
    for place_px, name in zip(picture.detections_px, picture.names, strict=True):
        panel.plot(*place_px, "s", color="red", markersize=16, fillstyle="none")
        panel.annotate(name, place_px, (0, 10), textcoords="offset points", fontsize=7, ha="center")
    height_px, width_px = image.shape[:2]
    panel.set_xlim(0, width_px)
    panel.set_ylim(height_px, 0)
    panel.set_title("the camera, and whom it found", fontsize=9)


def _draw_distances(panel: Axes, flight: Flight, count: int, places_au: FloatArray) -> None:
    times_au = flight.times_s[:count] / flight.mission.seconds_per_au
    for number, name in enumerate(flight.names):
        far_au = np.hypot(*(places_au[:count, number] - flight.agent_au[:count]).T)
        panel.plot(
            times_au,
            far_au,
            ".-",
            color=on_paper(number),
            linewidth=1.0,
            ms=2.0,
            label=f"to {name}",
        )
    panel.axhline(SENSOR_RADIUS_AU, color="gold", linewidth=1.0, label="it sees so far")
    panel.set_title("distance to each target (au)", fontsize=9)
    panel.set_xlabel("au of patrol", fontsize=8)
    panel.tick_params(labelsize=7)
    panel.set_ylim(0.0)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(fontsize=7, frameon=False)


def _ring(panel: Axes, centre_au: FloatArray, **style: Any) -> None:
    x_au, y_au = centre_au.tolist()
    panel.add_patch(Circle((x_au, y_au), SENSOR_RADIUS_AU, fill=False, **style))


def _show(panel: Axes, arena: Arena, values: FloatArray | ImageArray, title: str) -> None:
    (left, bottom), (right, top) = arena.bounds
    panel.imshow(
        values,
        extent=(left, right, bottom, top),
        origin="lower",
        cmap="viridis",
        vmin=0.0,
        vmax=1.0,
        interpolation="bilinear",
    )
    _frame(panel, arena, title)


def _frame(panel: Axes, arena: Arena, title: str) -> None:
    (left, bottom), (right, top) = arena.bounds
    panel.fill(*arena.outline_au.T, fill=False, ec="0.6", lw=0.8)
    for zone_au in arena.zones_au:
        panel.fill(*zone_au.T, fill=False, ec="tab:red", lw=0.8)
    panel.set_xlim(left, right)
    panel.set_ylim(bottom, top)
    panel.set_aspect("equal")
    panel.set_xticks([])
    panel.set_yticks([])
    panel.set_title(title, fontsize=9)
