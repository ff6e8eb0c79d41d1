"""Pictures of an evaluation: Unc over time, each target's uncertainty, a belief at one instant.

Source: paper, figures 1 and 4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from dronemon.arena import ARENA
from dronemon.belief import Belief
from dronemon.belief.metrics import GRID_SIZE
from dronemon.evaluation.episode import Episode
from dronemon.evaluation.options import Cell
from dronemon.evaluation.results import Result
from dronemon.problem import LOST_STD, MEASUREMENT_INTERVAL_AU, SENSOR_RADIUS_AU
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Measurement

LINE_STYLES = {"full": "-", "number": "--", "none": ":"}
"""By prior; colours tell methods apart."""
COLOURS = colormaps["tab10"]
MAX_COLUMNS = 5
DOTS_PER_INCH = 110


def draw_unc_over_time(results: Sequence[Result], path: Path) -> None:
    """Draw mean uncertainty over the mission, a panel per number of targets and speed ratio."""
    counts = sorted({result.cell.num_targets for result in results})
    speeds = sorted({result.cell.speed_ratio for result in results})
    methods = list(dict.fromkeys(result.method for result in results))
    figure = Figure(
        figsize=(3.2 * len(speeds) + 1.0, 2.4 * len(counts) + 0.8), layout="constrained"
    )
    panels = figure.subplots(len(counts), len(speeds), sharex=True, sharey=True, squeeze=False)
    groups: dict[tuple[Cell, str], list[tuple[float, ...]]] = {}
    for result in results:
        groups.setdefault((result.cell, result.method), []).append(result.unc_over_time)
    for (cell, method), curves in groups.items():
        panel = panels[counts.index(cell.num_targets), speeds.index(cell.speed_ratio)]
        mean = np.mean(curves, axis=0)
        panel.plot(
            MEASUREMENT_INTERVAL_AU * np.arange(1, len(mean) + 1),
            mean,
            LINE_STYLES[cell.prior],
            color=COLOURS(methods.index(method) % 10),
            linewidth=1.0,
            label=method if cell.prior == "full" else f"{method}, prior: {cell.prior}",
        )
        panel.set_title(f"N = {cell.num_targets}, $r_v$ = {cell.speed_ratio}", fontsize=9)
    handles = {
        label: handle
        for panel in panels.flat
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=4)
    figure.supxlabel("trajectory length (au)")
    figure.supylabel("Unc")
    figure.savefig(path, dpi=DOTS_PER_INCH)


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
    figure.savefig(path, dpi=DOTS_PER_INCH)


def draw_overview(episode: Episode, instant: int, title: str, path: Path) -> None:
    """Draw the belief of each target, the path flown, the truth, and distances over time.

    instant: index of the measurement at which the belief is shown
    """
    num_targets = episode.targets_au.shape[1]
    num_columns = min(num_targets + 1, MAX_COLUMNS)
    num_rows = math.ceil((num_targets + 1) / num_columns)
    figure = Figure(figsize=(2.5 * num_columns, 2.7 * num_rows + 2.2), layout="constrained")
    grid = figure.add_gridspec(num_rows + 1, num_columns, height_ratios=[1.3] * num_rows + [1.0])
    mean = believe(episode, instant)
    (left, bottom), (right, top) = ARENA.low_au, ARENA.high_au
    for index in range(num_targets + 1):
        panel = figure.add_subplot(grid[index // num_columns, index % num_columns])
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
        panel.set_title("all targets" if is_all else f"target {index + 1}", fontsize=9)
        panel.set_xticks([])
        panel.set_yticks([])
    _draw_distances(figure.add_subplot(grid[num_rows, :]), episode, instant)
    figure.suptitle(title)
    figure.savefig(path, dpi=DOTS_PER_INCH)


def believe(episode: Episode, instant: int) -> FloatArray:
    """Mean of every target's belief at one measurement. -> (N, 40, 40), x first."""
    first_au = episode.targets_au[0]
    is_placed = episode.conditions.prior == "full"
    sightings = Sightings(first_au if is_placed else np.full_like(first_au, np.nan))
    times_au = episode.conditions.times_au
    for index in range(1, instant + 1):
        seen = episode.observed[index]
        sightings.add(
            Measurement(
                time_au=float(times_au[index]),
                agent_au=episode.agent_au[index],
                seen=seen,
                target_au=np.where(seen[:, None], episode.targets_au[index], np.nan),
            )
        )
    points_au = ARENA.grid(GRID_SIZE)
    now_au = np.full((len(points_au), 1), times_au[instant])
    mean = Belief(sightings).mean(np.concatenate([points_au, now_au], axis=1))
    return mean.reshape(-1, GRID_SIZE, GRID_SIZE)


def _draw_truth(panel: Axes, episode: Episode, instant: int, targets: Sequence[int]) -> None:
    """Mark where targets truly are, and their areas."""
    for target in targets:
        x, y = episode.targets_au[instant, target].tolist()
        colour = COLOURS(target % 10)
        panel.plot(x, y, "s", color=colour, markersize=4)
        panel.add_patch(Circle((x, y), SENSOR_RADIUS_AU, fill=False, color=colour, linestyle=":"))


def _draw_agent(panel: Axes, agent_au: FloatArray) -> None:
    """Mark the agent and its field of view."""
    x, y = agent_au.tolist()
    panel.plot(x, y, "o", color="cyan", markersize=4)
    panel.add_patch(Circle((x, y), SENSOR_RADIUS_AU, fill=False, color="yellow"))


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
