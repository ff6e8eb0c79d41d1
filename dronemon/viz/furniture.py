"""What a map needs to be read: scale, north, whose colour is whose, and words on what is shown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from dronemon.palette import round_length_m, target_rgb
from dronemon.viz.entities import GREY, WHITE, dots, lines

LEGEND_SHARE = 0.35
"""Of the area's width, what the legend takes left of it."""
_SCALE_SHARE = 0.25
_ROW_SHARE = 0.09
HELP = """
# What is what

**Map.** North is up. The grey line is the area's border, red ones are no-fly zones, the blue one is
the fence, the arrow the drone; the white circle round it is what its camera can see of the ground.
A target's *colour* is where it is expected now; *grey fog* is where nobody looked lately. A *dot*
is where a target was seen last, a *ring* where it truly is (known only in simulation). The white
trail is the last two minutes. Thin lines ahead are the ways that the planner weighed, the better
the brighter.

**Camera.** The newest picture, what the detector found in it, and the circle within which finding
counts.

**Time since seen.** Seconds since each target was seen; a line that climbs is a target out of
sight.

**Battery.** What is left, and what it would take to come home from here.

**Beliefs.** *Expected*: how likely the target is in each place, from 0 to 1. *Uncertainty*: how
unsure that is, from 0 (just looked) to 1 (nothing known). *Soon*: the same two au of flight
later.

**Attention** (planner `stamp` alone). What the network looked at when it chose the next waypoint:
one small map per head, in which a large bright dot is a place that counted much; the white dot is
the drone. Beside it, which target counted how much, and how far back in its memory it looked.

All times are the vehicle's.
"""


def lay_furniture(
    rec: rr.RecordingStream, half_m: float, side_m: float, names: Sequence[str]
) -> None:
    """Draw scale, north and legend beside the area, and the page of words; all of it stays.

    half_m: half the width of what the map shows of the area
    """
    row_m, middle_m = _ROW_SHARE * side_m, -half_m - 0.5 * LEGEND_SHARE * side_m
    length_m = round_length_m(_SCALE_SHARE * side_m)
    ends_m = middle_m + length_m * np.array([-0.5, 0.5])
    bar = np.stack([ends_m, np.full(2, half_m - row_m)], axis=-1)
    scale = lines([bar], WHITE, 2.0, labels=[f"{length_m:g} m"])
    rec.log("map/furniture/scale", scale, static=True)
    tip = np.array([middle_m, -half_m + 0.5 * row_m])
    shaft = tip + row_m * np.array([[0.0, 1.4], [0.0, 0.0]])
    head = tip + row_m * np.array([[-0.2, 0.3], [0.0, 0.0], [0.2, 0.3]])
    letter = dots(shaft[:1], GREY, 0.5, labels=["N"])  # below it, where it covers nothing
    rec.log("map/furniture/north", lines([shaft, head], GREY, 1.5), letter, static=True)
    rows_m = tip[1] + row_m * (2.5 + np.arange(len(names)))
    places = np.stack([np.full(len(names), middle_m), rows_m], axis=-1)
    colors = [target_rgb(number) for number in range(len(names))]
    rec.log("map/furniture/targets", dots(places, colors, 4.0, labels=list(names)), static=True)
    rec.log("help", rr.TextDocument(HELP.strip(), media_type="text/markdown"), static=True)
