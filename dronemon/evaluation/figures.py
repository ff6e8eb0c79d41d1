"""Pictures of an evaluation: Unc over time, each target's uncertainty, a belief at one instant.

Source: paper, figures 1 and 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.gridspec import GridSpec
from matplotlib.patches import Circle

from dronemon.arena import ARENA
from dronemon.belief import Belief
from dronemon.belief.grid import GRID_SIZE
from dronemon.evaluation.episode import Episode
from dronemon.evaluation.options import DEFAULT_NODES, Cell
from dronemon.evaluation.results import Result
from dronemon.evaluation.sections import TABLE2_ROWS, Covered, published_table2
from dronemon.evaluation.tables import Row, grouped
from dronemon.problem import LOST_STD, MEASUREMENT_INTERVAL_AU, SENSOR_RADIUS_AU
from dronemon.sightings import Sightings, told
from dronemon.types import FloatArray

COLOURS = colormaps["tab10"]
MAX_COLUMNS = 5
DOTS_PER_INCH = 110
LEGEND_ENTRY_INCH = 2.2


def draw_over_time(
    results: Sequence[Result], value: Callable[[Result], Sequence[float]], label: str, path: Path
) -> None:
    """Draw means over instances with their standard errors.

    A panel per number of targets and world, which is speed ratio, prior, motion and sensor.

    value: (S,) of an episode at each measurement; label: what it is
    """
    counts = sorted({result.cell.num_targets for result in results})
    worlds = list(dict.fromkeys(_world(result.cell) for result in results))
    methods = list(dict.fromkeys(result.method for result in results))
    num_columns = min(len(worlds), MAX_COLUMNS)
    num_rows = math.ceil(len(counts) * len(worlds) / num_columns)
    figure = Figure(figsize=(3.2 * num_columns + 1.0, 2.4 * num_rows + 0.8), layout="constrained")
    grid = figure.subplots(num_rows, num_columns, sharex=True, sharey=True, squeeze=False)
    panels = dict(zip(product(counts, worlds), grid.flat, strict=False))
    for (cell, method), group in grouped(results).items():
        curves = [value(result) for result in group]
        panel = panels[cell.num_targets, _world(cell)]
        mean = np.mean(curves, axis=0)
        times_au = MEASUREMENT_INTERVAL_AU * np.arange(1, len(mean) + 1)
        colour = COLOURS(methods.index(method) % 10)
        name = method + ("" if cell.num_nodes == DEFAULT_NODES else f", V = {cell.num_nodes}")
        panel.plot(times_au, mean, color=colour, linewidth=1.0, label=name)
        if len(curves) > 1:
            error = np.std(curves, axis=0, ddof=1) / math.sqrt(len(curves))
            panel.fill_between(times_au, mean - error, mean + error, color=colour, alpha=0.2, lw=0)
        panel.set_title(f"N = {cell.num_targets}, {_world(cell)}", fontsize=9)
    for empty in grid.flat[len(panels) :]:
        empty.remove()
    _add_legend(figure, panels.values())
    figure.supxlabel("trajectory length (au)")
    figure.supylabel(label)
    _save(figure, path)


def _world(cell: Cell) -> str:
    """What figures call what a column of theirs shows."""
    prior = "" if cell.prior == "full" else f", prior: {cell.prior}"
    motion = "" if cell.motion == "tsp" else ", " + cell.motion.replace("$", r"\$")
    sensor = "" if cell.sensor.is_perfect else f", {cell.sensor}"
    return f"$r_v$ = {cell.speed_ratio}{prior}{motion}{sensor}"


def draw_conditions(covered: Sequence[Covered], name: str, path: Path) -> None:
    """Draw what share of the way each planner covers: motions along, a panel per eye and prior.

    name: unc or jsd
    """
    sensors = list(dict.fromkeys(str(of.cell.sensor) for of in covered))
    priors = list(dict.fromkeys(of.cell.prior for of in covered))
    motions = list(dict.fromkeys(of.cell.motion for of in covered))
    methods = list(dict.fromkeys(method for of in covered for method in of.shares))
    shares = {
        (str(of.cell.sensor), of.cell.prior, of.cell.motion, method): values[name]
        for of in covered
        for method, values in of.shares.items()
    }
    figure = Figure(
        figsize=(0.7 * len(motions) * len(priors) + 1.5, 2.2 * len(sensors) + 1.0),
        layout="constrained",
    )
    grid = figure.subplots(len(sensors), len(priors), sharex=True, sharey=True, squeeze=False)
    width = 0.8 / len(methods)
    for (sensor, prior), panel in zip(product(sensors, priors), grid.flat, strict=True):
        for m, method in enumerate(methods):
            heights = [shares.get((sensor, prior, motion, method), np.nan) for motion in motions]
            places = np.arange(len(motions)) + (m + 0.5) * width - 0.4
            panel.bar(places, heights, width, color=COLOURS(m % 10), label=method)
        panel.axhline(0.0, color="grey", linewidth=0.8)
        panel.axhline(1.0, color="grey", linewidth=0.8, linestyle="--")
        panel.set_title(f"sensor: {sensor}, prior: {prior}", fontsize=8)
        panel.set_ylim(-0.5, 1.2)
        panel.set_xticks(np.arange(len(motions)), motions, rotation=45, fontsize=8, ha="right")
    _add_legend(figure, grid.flat)
    figure.supylabel(f"share of the way in {'Unc' if name == 'unc' else 'JSD'}")
    _save(figure, path)


def _add_legend(figure: Figure, panels: Iterable[Axes]) -> None:
    """One legend of all panels, above them."""
    handles = {
        label: handle
        for panel in panels
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    num_columns = max(1, int(figure.get_figwidth() / LEGEND_ENTRY_INCH))
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=num_columns)


def _save(figure: Figure, path: Path) -> None:
    """Write PNG, and SVG beside it."""
    figure.savefig(path, dpi=DOTS_PER_INCH)
    figure.savefig(path.with_suffix(".svg"))


def draw_table2(flown: Mapping[str, Mapping[Cell, Row]], path: Path) -> None:
    """Draw JSD over the roadmap's size, a line per method, the paper's dashed.

    flown: method -> cell of Table II -> row
    """
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    panel = figure.subplots()
    published = published_table2()
    for index, (method, rows) in enumerate(flown.items()):
        colour, sizes = COLOURS(index % 10), [cell.num_nodes for cell in rows]
        jsd = [row.figures["jsd"] for row in rows.values()]
        panel.errorbar(
            sizes,
            [estimate.mean for estimate in jsd],
            yerr=[estimate.standard_error for estimate in jsd],
            color=colour,
            linewidth=1.0,
            capsize=2.0,
            label=method,
        )
        if name := TABLE2_ROWS.get(method):
            paper = published[name]
            label = f"paper: {name}"
            panel.plot(list(paper), list(paper.values()), "--", color=colour, lw=0.8, label=label)
    _add_legend(figure, [panel])
    panel.set_xlabel("nodes of the roadmap")
    panel.set_ylabel("JSD")
    _save(figure, path)


def draw_traces(uncertainties: Mapping[str, FloatArray], title: str, path: Path) -> None:
    """Draw each target's uncertainty in one episode, a panel per method.

    uncertainties: method -> (S+1, N); index 0 is before the first measurement
    """
    figure = Figure(figsize=(9.0, 1.9 * len(uncertainties) + 0.8), layout="constrained")
    panels = figure.subplots(len(uncertainties), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for panel, (method, unc) in zip(panels, uncertainties.items(), strict=True):
        times_au = MEASUREMENT_INTERVAL_AU * np.arange(len(unc))
        for target in range(unc.shape[1]):
            panel.plot(times_au, unc[:, target], color=COLOURS(target % 10), linewidth=1.0)
        panel.axhline(LOST_STD, color="black", linestyle="--", linewidth=0.8)
        panel.set_title(method, fontsize=9)
    figure.suptitle(f"Uncertainty over each target area: {title}")
    figure.supxlabel("trajectory length (au)")
    figure.supylabel(r"$\overline{\sigma}_i$")
    _save(figure, path)


def draw_overview(episodes: Mapping[str, Episode], instant: int, title: str, path: Path) -> None:
    """Draw, per method, each target's belief, the path flown, the truth, and distances over time.

    instant: index of the measurement at which beliefs are shown
    """
    num_targets = max(episode.targets_au.shape[1] for episode in episodes.values())
    num_columns = min(num_targets + 1, MAX_COLUMNS)
    num_rows = math.ceil((num_targets + 1) / num_columns)
    height = 2.7 * num_rows + 2.2
    figure = Figure(figsize=(2.5 * num_columns, height * len(episodes)), layout="constrained")
    parts = figure.subfigures(len(episodes), 1, squeeze=False)[:, 0]
    for part, (method, episode) in zip(parts, episodes.items(), strict=True):
        grid = part.add_gridspec(num_rows + 1, num_columns, height_ratios=[1.3] * num_rows + [1.0])
        _draw_beliefs(part, grid, episode, instant)
        _draw_distances(part.add_subplot(grid[num_rows, :]), episode, instant)
        part.suptitle(f"{method}: {title}")
    _add_legend(figure, [panel for part in parts for panel in part.axes])
    _save(figure, path)


def _draw_beliefs(part: SubFigure, grid: GridSpec, episode: Episode, instant: int) -> None:
    """A panel per target, and one of all of them."""
    num_targets = episode.targets_au.shape[1]
    mean = believe(episode, instant)
    (left, bottom), (right, top) = ARENA.low_au, ARENA.high_au
    for index in range(num_targets + 1):
        panel = part.add_subplot(grid[index // grid.ncols, index % grid.ncols])
        is_all = index == num_targets
        field = mean.max(axis=0) if is_all else mean[index]
        panel.imshow(
            field.T,
            origin="lower",
            extent=(left, right, bottom, top),
            vmin=0.0,
            vmax=1.0,
            cmap="viridis",
        )
        _draw_truth(panel, episode, instant, range(num_targets) if is_all else [index])
        if is_all:
            path_au = episode.agent_au[: instant + 1]
            panel.plot(path_au[:, 0], path_au[:, 1], color="white", linewidth=0.8, alpha=0.6)
        _draw_agent(panel, episode.agent_au[instant])
        panel.set(xlim=(left, right), ylim=(bottom, top))
        panel.set_title("all targets" if is_all else f"target {index + 1}", fontsize=9)
        panel.set_xticks([])
        panel.set_yticks([])


def believe(episode: Episode, instant: int) -> FloatArray:
    """Mean of every target's belief at one measurement. -> (N, 40, 40), x first."""
    first_au, conditions = episode.targets_au[0], episode.conditions
    priors_au = first_au if conditions.prior == "full" else np.full_like(first_au, np.nan)
    sightings = Sightings(priors_au, conditions.sensor)
    times_au = conditions.times_au
    for index in range(1, instant + 1):
        agent_au, told_au = episode.agent_au[index], episode.told_au[index]
        sightings.add(told(float(times_au[index]), agent_au, told_au))
    points_au = ARENA.grid(GRID_SIZE)
    now_au = np.full((len(points_au), 1), times_au[instant])
    mean = Belief(sightings).mean(np.concatenate([points_au, now_au], axis=1))
    return mean.reshape(-1, GRID_SIZE, GRID_SIZE)


def _draw_truth(panel: Axes, episode: Episode, instant: int, targets: Sequence[int]) -> None:
    """Mark where targets truly are, and their areas."""
    for target in targets:
        x, y = episode.targets_au[instant, target].tolist()
        colour = COLOURS(target % 10)
        panel.plot(x, y, "s", color=colour, markersize=4, label=f"target {target + 1}, truly")
        panel.add_patch(Circle((x, y), SENSOR_RADIUS_AU, fill=False, color=colour, linestyle=":"))


def _draw_agent(panel: Axes, agent_au: FloatArray) -> None:
    """Mark the agent and its field of view."""
    x, y = agent_au.tolist()
    panel.plot(x, y, "o", color="cyan", markersize=4, label="drone")
    circle = Circle((x, y), SENSOR_RADIUS_AU, fill=False, color="yellow", label="what it sees")
    panel.add_patch(circle)


def _draw_distances(panel: Axes, episode: Episode, instant: int) -> None:
    """Plot the distance from the agent to each target; below the dashed line it is in view."""
    times_au = episode.conditions.times_au
    distances_au = np.linalg.norm(episode.targets_au - episode.agent_au[:, None], axis=-1)
    for target in range(distances_au.shape[1]):
        panel.plot(times_au, distances_au[:, target], color=COLOURS(target % 10), linewidth=0.9)
    panel.axhline(SENSOR_RADIUS_AU, color="black", linestyle="--", linewidth=0.8)
    panel.axvline(times_au[instant], color="grey", linewidth=0.8)
    panel.set_xlabel("trajectory length (au)")
    panel.set_ylabel("distance (au)")
