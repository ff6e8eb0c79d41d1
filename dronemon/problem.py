"""The problem's constants, one definition each. Source: paper, sections III and V.

One au is the side of the paper's square, which is ten sensor radii.
"""

from __future__ import annotations

import math
from typing import Literal

SENSOR_RADIUS_AU = 0.1
"""Radius of the circular sensor footprint: a target strictly nearer is seen. Section III-B."""
SENSOR_AREA_AU2 = math.pi * SENSOR_RADIUS_AU**2
MEASUREMENT_INTERVAL_AU = 0.1
"""Distance flown between two measurements. Section IV-D."""
LENGTH_SCALE_AU = 0.1
"""Spatial length scale of the kernel. Section III-C."""
TIME_SCALE_AU = 3.0
"""Temporal length scale of the kernel. Section III-C."""
WINDOW_TIME_SCALES = 1.993
"""Age, in temporal length scales, from which a measurement no longer counts. Section III-C."""
WINDOW_AU = WINDOW_TIME_SCALES * TIME_SCALE_AU
"""That age with the default kernel."""
PREDICTION_AU = 2.0
"""How much later than now beliefs are looked at, too. Section IV-A."""
MAX_TARGETS = 100
"""Of a mission or an instance."""
DEFAULT_HISTORY, MAX_HISTORY = 100, 1000
"""T, the decisions that a learned planner looks back. Section V-A; the paper's Table II has 200."""
PRESENCE_STD_AU = 0.1
"""Spread of the bump that stands for a target's true presence in JSD. Section V-A."""
LOST_STD = 0.9
"""A target counts as lost where its mean standard deviation exceeds this. Section V-A."""

Prior = Literal["full", "number", "none"]
"""What is known at the start: positions and number of targets, their number alone, or nothing."""

MOTIONS = ("tsp", "waypoints", "correlated", "brownian", "grazing", "loop", "herd", "road")
"""How targets move, see `dronemon.world.motions`; the paper's is `tsp`."""


def is_tracks(motion: str) -> bool:
    """Whether a motion's name is that of a file of tracks."""
    return motion.lower().endswith((".csv", ".gpx"))


def motion_name_flaw(motion: str) -> str | None:
    """Why there is no motion of this name; None if there is, or if it is that of a file."""
    if motion in MOTIONS or is_tracks(motion):
        return None
    return f"{motion!r:.80} is none of {', '.join(MOTIONS)}, nor a .csv or .gpx file of tracks"


FIRST_DEVELOPMENT_SEED = 10_000
"""Seeds from here on are for choosing and tuning; 0 to 99 are for reporting alone."""
FIRST_TRAINING_SEED = 1_000_000
"""Seeds from here on are for training."""
