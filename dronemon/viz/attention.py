"""What a network looked at when it decided: every head's places, whom, and how long ago.

attention/places     a small map for each head of the spatial encoder, side by side
attention/whom/NAME  share of attention that each target has, mean over heads
attention/age        how long ago what is looked at was, in au, mean over heads
attention/heads      all heads in numbers, as a table
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from dronemon.arena import ARENA
from dronemon.palette import target_rgb
from dronemon.types import FloatArray, IntArray
from dronemon.viz.entities import BLUE, DARK, WHITE, dots, lines, path

_APART = 1.15
"""Between the maps of two heads, in their sides."""
_LARGEST = 12.0
"""Radius of the place that a head looks at most, on the screen."""
_TITLE = np.array([0.5, -1.06])
"""Where a head's name is written: above its map."""


class Attention:
    """Draws decisions of a network over one roadmap. nodes_au: (V, 2)."""

    def __init__(self, rec: rr.RecordingStream, names: Sequence[str], nodes_au: FloatArray) -> None:
        self._rec = rec
        self._names = names
        self._nodes = nodes_au * (1.0, -1.0)  # y points down
        self._is_laid = False
        for number, name in enumerate(names):
            style = rr.SeriesLines(colors=target_rgb(number), names=name, widths=2.0)
            rec.log(path("attention", "whom", name), style, static=True)
        style = rr.SeriesLines(colors=BLUE, names="looks back (au)", widths=1.5)
        rec.log("attention/age", style, static=True)

    def draw(self, attention: Mapping[str, FloatArray | IntArray]) -> None:
        """Show a decision. attention: arrays by the names of `policy.Explanation`."""
        here = int(attention["nodes"][0])
        weights = {name: np.asarray(array, np.float64) for name, array in attention.items()}
        self._draw_places(weights["spatial"][:, 0], here)
        beliefs = weights["target"][here]
        tracks = weights["tracks"][:, 0] if "tracks" in weights else beliefs
        if tracks.shape[1] == len(self._names):
            for name, share in zip(self._names, tracks.mean(0).tolist(), strict=True):
                self._rec.log(path("attention", "whom", name), rr.Scalars(share))
            table = _table(self._names, tracks, beliefs)
            document = rr.TextDocument(table, media_type="text/markdown")
            self._rec.log("attention/heads", document)
        if "temporal" in weights:
            age_au = float((weights["temporal"][here] * weights["ages_au"]).sum(-1).mean())
            self._rec.log("attention/age", rr.Scalars(age_au))

    def _draw_places(self, shares: FloatArray, here: int) -> None:
        """A map of each head: the larger and brighter a node, the more it looks there.

        shares: (H, V)
        """
        columns = math.ceil(math.sqrt(len(shares)))
        offsets = [_APART * np.array([h % columns, h // columns]) for h in range(len(shares))]
        if not self._is_laid:
            self._is_laid = True
            places = np.concatenate([self._nodes + offset for offset in offsets])
            self._rec.log("attention/places/nodes", rr.Points2D(places), static=True)
            outline = ARENA.outline_au * (1.0, -1.0)
            borders = lines([outline + offset for offset in offsets], DARK, 1.0, order=5)
            self._rec.log("attention/places/border", borders, static=True)
            labels = [f"head {head + 1}" for head in range(len(shares))]
            titles = dots([_TITLE + offset for offset in offsets], WHITE, 0.5, labels=labels)
            self._rec.log("attention/places/titles", titles, static=True)
        much = np.sqrt(shares / shares.max(1, keepdims=True)).ravel()
        rgba = [(*BLUE, round(40 + 215 * m)) for m in much]
        radii = rr.Radius.ui_points(1.0 + _LARGEST * much)
        looks = rr.Points2D.from_fields(colors=rgba, radii=radii)
        self._rec.log("attention/places/nodes", looks)
        drone = dots([self._nodes[here] + offset for offset in offsets], WHITE, 4.0, order=60)
        self._rec.log("attention/places/drone", drone)


def _table(names: Sequence[str], tracks: FloatArray, beliefs: FloatArray) -> str:
    """Whom each head looks at, in per cent. tracks, beliefs: (H, N)."""
    rows = ["| head | " + " | ".join(names) + " |", "|---" * (1 + len(names)) + "|"]
    for title, shares in (("track", tracks), ("belief", beliefs)):
        for head, share in enumerate(shares):
            told = " | ".join(f"{100.0 * s:.0f}" for s in share)
            rows.append(f"| {title} {head + 1} | {told} |")
    return "Share of attention (%)\n\n" + "\n".join(rows)
