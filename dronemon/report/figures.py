"""The report's figures: the map, each target's story, where nobody looked, and the vehicle."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D, Transform

from dronemon.palette import on_paper, round_length_m
from dronemon.problem import LOST_STD
from dronemon.report.flight import RECENTLY_S, Flight
from dronemon.types import FloatArray

_SHORT_NAME = 12
"""Letters of a name that leave room for two more beside it."""
_SHARE_OF_SCALE = 0.3
"""Most that the scale bar takes of the map's width."""


def draw_map(flight: Flight) -> Figure:
    """Field, track, sightings, the last belief, and fog where nobody looked lately; north is up."""
    figure = Figure(figsize=(7.2, 6.4), layout="constrained")
    panel = figure.add_subplot()
    _draw_beliefs(panel, flight)
    border = _to_map(flight, flight.frame.arena.outline_au)
    panel.plot(*border.T, color="0.3", linewidth=1.2)
    for number, zone_au in enumerate(flight.frame.arena.zones_au):
        label = "no-fly" if number == 0 else None
        panel.fill(*_to_map(flight, zone_au).T, fill=False, ec="tab:red", hatch="//", label=label)
    way = _to_map(flight, flight.agent_au)
    panel.plot(*way.T, color="0.35", linewidth=0.6, label="the drone's way")
    for place, mark, label in ((way[0], "^", "its start"), (way[-1], "s", "its end")):
        panel.plot(*place, mark, color="0.2", markersize=5.0, label=label)
    for number, name in enumerate(flight.names):
        seen_au = flight.seen_au[flight.seen[:, number] > 0.0, number]
        places = _to_map(flight, seen_au)
        panel.plot(*places.T, "o", color=on_paper(number), markersize=4.5, mec="white", mew=0.5)
        last = places[-1:]
        label = f"seen last: {name}" if len(last) else f"never seen: {name}"
        marker = "o" if len(last) else "None"
        panel.plot(*last.T, marker, color=on_paper(number), mec="black", ms=7.0, label=label)
    low, high = border.min(axis=0), border.max(axis=0)
    _draw_scale(panel, low, high)
    panel.annotate(
        "N",
        (0.97, 0.99),
        (0.97, 0.90),
        "axes fraction",
        ha="center",
        arrowprops={"arrowstyle": "->"},
    )
    margin = 0.06 * float((high - low).max())
    panel.set_xlim(low[0] - margin, high[0] + margin)
    panel.set_ylim(low[1] - 1.6 * margin, high[1] + margin)
    panel.set_aspect("equal")
    panel.set_axis_off()
    story = flight.story
    panel.set_title(f"{story.title}, {story.started:%Y-%m-%d}", fontsize=9, wrap=True)
    columns = 3 if max(map(len, flight.names)) <= _SHORT_NAME else 1
    panel.legend(
        loc="upper left", bbox_to_anchor=(0.0, 0.0), ncols=columns, fontsize=8, frameon=False
    )
    return figure


def _draw_beliefs(panel: Axes, flight: Flight) -> None:
    """Fog where nobody looked lately, and each target's colour where it is expected."""
    transform = _au_to_map(flight) + panel.transData
    fog = np.clip(flight.unseen_for_s / RECENTLY_S, 0.0, 1.0)
    layers = [_layer((0.45, 0.48, 0.52), 0.55 * fog)]
    for number, mean in enumerate(flight.mean):
        layers.append(_layer(on_paper(number), 0.85 * np.clip(mean, 0.0, 1.0)))
    (left, bottom), (right, top) = flight.frame.arena.bounds
    (border,) = panel.fill(*_to_map(flight, flight.frame.arena.outline_au).T, fill=False, lw=0.0)
    for layer in layers:
        image = panel.imshow(
            layer,
            extent=(left, right, bottom, top),
            origin="lower",
            interpolation="bilinear",
            transform=transform,
        )
        image.set_clip_path(border)


def _layer(rgb: tuple[float, float, float], alpha: FloatArray) -> FloatArray:
    """(G, G) of opacity -> (G, G, 4)."""
    return np.concatenate([np.broadcast_to(rgb, (*alpha.shape, 3)), alpha[..., None]], axis=-1)


def _to_map(flight: Flight, places_au: FloatArray) -> FloatArray:
    """(..., 2) au -> (..., 2) m east and north of the area's centre."""
    ned_m = flight.frame.au_to_ned(places_au) - np.array(flight.frame.centre_ned_m)
    east_north_m: FloatArray = ned_m[..., ::-1]
    return east_north_m


def _au_to_map(flight: Flight) -> Transform:
    """The same for pictures."""
    origin, x_end, y_end = _to_map(flight, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    across, along = x_end - origin, y_end - origin
    matrix = [[across[0], along[0], origin[0]], [across[1], along[1], origin[1]], [0.0, 0.0, 1.0]]
    return Affine2D(np.array(matrix))


def _draw_scale(panel: Axes, low: FloatArray, high: FloatArray) -> None:
    """A bar of a round length below the map."""
    length_m = round_length_m(_SHARE_OF_SCALE * float(high[0] - low[0]))
    row = low[1] - 0.05 * float(high[1] - low[1])
    panel.plot([high[0] - length_m, high[0]], [row, row], color="black", linewidth=2.0)
    panel.annotate(
        f"{length_m:g} m",
        (high[0] - 0.5 * length_m, row),
        (0, -3),
        va="top",
        ha="center",
        textcoords="offset points",
        fontsize=8,
    )


def draw_targets(flight: Flight) -> Figure:
    """When each target was seen, and how unsure the belief was where it was seen last."""
    figure = Figure(figsize=(7.2, 0.6 + 0.75 * len(flight.names)), layout="constrained")
    panels = figure.subplots(len(flight.names), 1, sharex=True, squeeze=False)[:, 0]
    minutes = flight.times_s / 60.0
    for number, (panel, name) in enumerate(zip(panels, flight.names, strict=True)):
        panel.plot(minutes, flight.std[:, number], color=on_paper(number), linewidth=1.2)
        panel.axhline(LOST_STD, color="0.6", linewidth=0.8, linestyle="--")
        seen = minutes[flight.seen[:, number] > 0.0]
        panel.vlines(seen, 1.02, 1.22, color=on_paper(number), linewidth=1.0)
        panel.set_ylim(0.0, 1.25)
        panel.set_yticks([0.0, LOST_STD], ["0", f"{LOST_STD:g}"])
        panel.set_ylabel(name, rotation=0, ha="right", va="center", fontsize=8)
        panel.tick_params(labelsize=7)
        panel.spines[["top", "right"]].set_visible(False)
    panels[-1].set_xlabel("minutes of patrol", fontsize=8)
    return figure


def draw_vehicle(flight: Flight) -> Figure:
    """Battery beside what the way home takes, and the time of each decision."""
    figure = Figure(figsize=(7.2, 2.0), layout="constrained")
    battery, decisions = figure.subplots(1, 2)
    minutes = flight.times_s / 60.0
    battery.plot(minutes, 100.0 * flight.battery, color="black", label="left")
    battery.plot(
        minutes, 100.0 * flight.battery_needed, color="tab:red", label="needed to come home"
    )
    battery.set_ylim(0.0, 105.0)
    battery.set_ylabel("battery (%)", fontsize=8)
    battery.legend(fontsize=7, frameon=False)
    decisions.semilogy(flight.decisions[:, 0] / 60.0, flight.decisions[:, 1], ".", color="black")
    for formatter in (decisions.yaxis.set_major_formatter, decisions.yaxis.set_minor_formatter):
        formatter("{x:g}")
    decisions.tick_params(axis="y", which="minor", labelsize=6)
    decisions.set_ylabel("decision (ms)", fontsize=8)
    for panel in (battery, decisions):
        panel.set_xlabel("minutes of patrol", fontsize=8)
        panel.tick_params(labelsize=7)
        panel.spines[["top", "right"]].set_visible(False)
    return figure


FIGURES: dict[str, Callable[[Flight], Figure]] = {
    "map": draw_map,
    "targets": draw_targets,
    "vehicle": draw_vehicle,
}
"""By the names that the page's template uses."""


def svg(figure: Figure) -> str:
    """The figure as an element of a page."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    return text[text.index("<svg") :]


def save_png(figure: Figure, path: Path) -> None:
    """The figure as a picture. Raises OSError."""
    figure.savefig(path, dpi=150)
