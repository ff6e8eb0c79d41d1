"""The picture of a decision: whom, when and where the network looks at, and what it chooses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, FigureBase
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

from dronemon.arena import ARENA
from dronemon.explain.replay import Replay
from dronemon.palette import on_paper
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import FloatArray

HEADS = colormaps["Dark2"]
_TOLD = 0.1
"""Probability from which a neighbour's is written beside it."""
_SHORT, _LINE = 30, 148
"""Letters that have room side by side: of names below a table, of a title."""


def caption(replay: Replay) -> str:
    """What the arrays show, in two sentences: means over heads, at the agent's node."""
    own, names = replay.explanation, replay.target_names
    here, *neighbours = own.nodes.tolist()
    looks = []
    if own.tracks is not None:
        tracks = [f"{n}'s track, {ago}" for n, ago in zip(names, _ages(replay), strict=True)]
        looks.append(_most(own.tracks[:, 0], tracks))
    looks.append(_most(own.target[here], [f"the belief about {name}" for name in names]))
    if own.temporal is not None and own.ages_au is not None:
        ages = [f"the past of {age_au:.1f} au ago" for age_au in own.ages_au]
        looks.append(_most(own.temporal[here], ages))
    away_au = np.hypot(*(replay.nodes_au - replay.nodes_au[here]).T)
    places = [f"node {node}, {far_au:.2f} au away" for node, far_au in enumerate(away_au)]
    places[here] = "its own node"
    nearest = away_au.argsort()
    sums = own.spatial[:, 0].mean(0)[nearest].cumsum()
    half_au = away_au[nearest[np.searchsorted(sums, 0.5)]]
    chance = own.pointer[neighbours.index(replay.chosen)]
    return (
        f"Decision {replay.number} at {replay.time_au:.1f} au goes from node {here} to node "
        f"{replay.chosen} (p {chance:.2f}). It looks most at {', '.join(looks)}, and at "
        f"{_most(own.spatial[:, 0], places)}, half within {half_au:.2f} au."
    )


def _most(weights: FloatArray, names: Sequence[str]) -> str:
    """What is looked at most, and its share. weights: (H, n)."""
    mean = weights.mean(0)
    return f"{names[int(mean.argmax())]} ({100.0 * mean.max():.0f} %)"


def _ages(replay: Replay) -> list[str]:
    """How long ago every target was seen, in words."""
    ages_au = replay.time_au - replay.last_seen_au
    return [f"seen {age:.1f} au ago" if np.isfinite(age) else "never seen" for age in ages_au]


def draw(replay: Replay, path: Path) -> None:
    """Draw maps of places and targets above, shares by head below."""
    own = replay.explanation
    figure = Figure(figsize=(13.0, 10.2), layout="constrained")
    maps, shares = figure.subfigures(2, 1, height_ratios=(6.6, 3.2), squeeze=False)[:, 0]
    draw_maps(maps, replay)
    here, names = own.nodes[0], replay.target_names
    heads = [f"head {head + 1}" for head in range(len(own.decoder))]
    numbers = [str(node) for node in own.nodes[1:]]
    tables = [(f"whom: beliefs, at node {here}", own.target[here], names)]
    if own.tracks is not None:
        tables.append((f"whom: tracks, at node {here}", own.tracks[:, 0], names))
    choice = np.vstack([own.decoder, own.pointer])
    tables.append(("neighbours: decoder, and the pointer", choice, numbers))
    widths = [1.0] * (len(tables) - 1) + [1.8, 1.8]
    panels = shares.subplots(1, len(widths), width_ratios=widths)
    for panel, table in zip(panels, tables, strict=False):
        _draw_table(panel, *table, [*heads, "pointer"])
    _draw_past(panels[-1], replay)
    told = caption(replay).replace(" %", "\N{NO-BREAK SPACE}%")
    sentences = told.replace(". It looks", ".\nIt looks").splitlines()
    figure.suptitle("\n".join(fill(sentence, _LINE) for sentence in sentences), fontsize=10.5)
    figure.savefig(path, dpi=90)


def draw_maps(figure: FigureBase, replay: Replay) -> None:
    """Draw where the agent looks and what it weighs, and beside it whom every node looks at."""
    left, right = figure.subplots(1, 2)
    _draw_places(left, replay)
    _draw_ownership(right, replay)


def _draw_places(panel: Axes, replay: Replay) -> None:
    """Draw where the agent's node looks, and the probability of every neighbour."""
    own, nodes_au = replay.explanation, replay.nodes_au
    shares = 100.0 * own.spatial[:, 0].mean(0)
    here_au, (east_au, north_au) = nodes_au[own.nodes[0]], nodes_au.T
    panel.plot(*replay.path_au.T, color="0.8", linewidth=1.0, zorder=0, label="flown so far")
    dots = panel.scatter(
        east_au,
        north_au,
        c=shares,
        s=12.0 + 14.0 * shares,
        cmap="YlOrRd",
        norm=Normalize(0.0),
        edgecolors="0.6",
        linewidths=0.4,
        zorder=2,
    )
    panel.figure.colorbar(dots, ax=panel, shrink=0.7, label="spatial attention (%)")
    for node, chance in zip(own.nodes[1:], own.pointer, strict=True):
        way_au = np.stack([here_au, nodes_au[node]])
        panel.plot(*way_au.T, color="tab:blue", linewidth=0.5 + 6.0 * chance, alpha=0.7, zorder=1)
        if chance >= _TOLD or node == replay.chosen:
            _label(panel, f"{chance:.2f}", nodes_au[node], nodes_au[node] - here_au)
    panel.plot(*here_au, "^", color="black", markersize=9, zorder=4, label="the drone")
    (ring,) = panel.plot(*nodes_au[replay.chosen], "o", markersize=14, zorder=4, label="chosen")
    ring.set(markerfacecolor="none", markeredgecolor="tab:blue", markeredgewidth=2.0)
    _frame(panel, f"where node {own.nodes[0]} looks (mean over heads), and the pointer")
    _draw_last_places(panel, replay)  # the other map's legend tells whose


def _label(panel: Axes, text: str, place_au: FloatArray, away_au: FloatArray) -> None:
    """Write beside a place, on the side that lies away."""
    right, up = 12.0 * away_au / max(float(np.hypot(*away_au)), 1e-9)
    panel.annotate(
        text,
        (place_au[0], place_au[1]),
        xytext=(right, up),
        textcoords="offset points",
        ha="left" if right > 0.0 else "right",
        va="center",
        fontsize=8,
        color="tab:blue",
        zorder=5,
        path_effects=[withStroke(linewidth=3.0, foreground="white")],
    )


def _draw_ownership(panel: Axes, replay: Replay) -> None:
    """Draw whom every node looks at most."""
    shares = replay.explanation.target.mean(1)  # (V, N)
    whom, even = shares.argmax(1), 1.0 / shares.shape[1]
    excess = shares.max(1) - even
    excess /= max(float(excess.max()), 1e-9)
    colours = np.array([(*on_paper(int(target)), 1.0) for target in whom])
    colours[:, 3] = 0.25 + 0.75 * excess
    east_au, north_au = replay.nodes_au.T
    panel.scatter(east_au, north_au, c=colours, s=15.0 + 90.0 * excess, linewidths=0.0)
    panel.plot(*replay.nodes_au[replay.explanation.nodes[0]], "^", color="black", markersize=9)
    _draw_last_places(panel, replay)
    _frame(panel, "whom each node looks at most (mean over heads); the larger, the more")


def _draw_last_places(panel: Axes, replay: Replay) -> None:
    """Mark where every target was seen last, and how long ago."""
    known = zip(replay.target_names, replay.last_places_au, _ages(replay), strict=True)
    for target, (name, place_au, ago) in enumerate(known):
        if not np.isfinite(place_au).all():
            continue
        colour = on_paper(target)
        (cross,) = panel.plot(*place_au, "X", color=colour, label=f"{ago}: {name}")
        cross.set(markersize=10, markeredgecolor="white")
        panel.add_patch(
            Circle(
                (place_au[0], place_au[1]),
                SENSOR_RADIUS_AU,
                fill=False,
                color=colour,
                linestyle=":",
            )
        )


def _frame(panel: Axes, title: str) -> None:
    low_au, high_au = ARENA.bounds
    panel.set(xlim=(low_au[0], high_au[0]), ylim=(low_au[1], high_au[1]), aspect="equal")
    panel.set(xlabel="east (au)", ylabel="north (au)")
    panel.set_title(title, fontsize=10)
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=3, fontsize=8)


def _draw_table(
    panel: Axes, title: str, shares: FloatArray, names: Sequence[str], rows: Sequence[str]
) -> None:
    """Draw shares in per cent. shares: (number of rows or fewer, number of names)."""
    panel.imshow(shares, cmap="YlOrRd", vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        ink = "white" if share > 0.6 else "black"
        panel.text(column, row, f"{100 * share:.0f}", ha="center", va="center", color=ink)
    turn_deg = 90.0 if len("".join(names)) > _SHORT else 0.0
    panel.set_xticks(range(len(names)), names, rotation=turn_deg)
    panel.set_yticks(range(len(shares)), rows[: len(shares)])
    panel.set_title(f"{title} (%)", fontsize=10)


def _draw_past(panel: Axes, replay: Replay) -> None:
    """Draw which of its own past the agent's node looks at."""
    own = replay.explanation
    if own.temporal is None or own.ages_au is None:
        panel.text(0.5, 0.5, "an LSTM: no weights of the past", ha="center", va="center")
        panel.set_axis_off()
        return
    shares = 100.0 * own.temporal[own.nodes[0]]
    for head, share in enumerate(shares):
        panel.plot(own.ages_au, share, ".-", color=HEADS(head % 8), label=f"head {head + 1}")
    panel.plot(own.ages_au, shares.mean(0), color="black", linewidth=2.5, alpha=0.5, label="mean")
    panel.invert_xaxis()
    panel.set(xlabel="flown since (au)", ylabel="temporal attention (%)", ylim=(0.0, 105.0))
    panel.set_title(f"when: node {own.nodes[0]} at its own past", fontsize=10)
    panel.legend(fontsize=8)
