from __future__ import annotations

import numpy as np
import pytest

from dronemon.planner.lawnmower import LANE_SPACING_AU, Sweep, sweep_length_au, sweep_track
from dronemon.types import FloatArray


def along(track_au: FloatArray, spacing_au: float = 0.005) -> FloatArray:
    """Points of a closed track."""
    points = []
    for start, end in zip(track_au, np.roll(track_au, -1, axis=0), strict=True):
        count = int(np.linalg.norm(end - start) / spacing_au) + 1
        points.append(np.linspace(start, end, count))
    return np.concatenate(points)


def test_sweep_is_a_closed_loop_of_axis_parallel_lanes_that_comes_near_every_place() -> None:
    track_au = sweep_track()
    steps = np.roll(track_au, -1, axis=0) - track_au
    assert np.all(np.isclose(steps, 0.0).sum(axis=1) == 1)
    axis = np.linspace(0.5 * LANE_SPACING_AU, 1.0 - 0.5 * LANE_SPACING_AU, 40)
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 1, 2)
    nearest = np.linalg.norm(places - along(track_au), axis=-1).min(axis=1)
    assert nearest.max() <= 0.6 * LANE_SPACING_AU
    assert sweep_length_au(track_au) == pytest.approx(np.abs(steps).sum())


def test_sweep_goes_round_from_its_nearest_corner() -> None:
    sweep, track_au = Sweep(), sweep_track()
    here_au = track_au[3] + [0.01, 0.01]
    visited = []
    for _ in range(9):
        here_au = sweep.next_place(here_au)
        visited.append(here_au)
    np.testing.assert_array_equal(visited, np.roll(track_au, -3, axis=0)[[*range(8), 0]])


def test_sweep_keeps_its_corner_until_it_is_reached() -> None:
    sweep = Sweep()
    first = sweep.next_place(np.array([0.1, 0.1]))
    np.testing.assert_array_equal(sweep.next_place(np.array([0.9, 0.9])), first)
