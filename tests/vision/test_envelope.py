"""The ground as a flight follows it: never below it, nowhere too steep, and no higher than that."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dronemon.frames import GeoPoint, degrees_to_ned
from dronemon.types import FloatArray
from dronemon.vision.envelope import Envelope
from dronemon.vision.heights import HeightGrid
from dronemon.vision.terrain import Terrain

CELL_DEG = 1e-4
STEEPEST = 0.24


def hilly(seed: int, kind: str, shape: tuple[int, int], latitude_deg: float = 47.0) -> HeightGrid:
    """Hills of a kind, drawn."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    heights_m = {
        "noise": lambda: rng.uniform(-50.0, 50.0, shape),
        "cliff": lambda: np.where(columns > rng.integers(shape[1]), 80.0, 0.0),
        "masts": lambda: np.where(rng.random(shape) < 0.03, rng.uniform(0, 100, shape), 5.0),
        "waves": lambda: (
            30 * np.sin(rows / rng.uniform(1, 9)) * np.cos(columns / rng.uniform(1, 9))
        ),
        "holes": lambda: np.where(rng.random(shape) < 0.3, np.nan, rng.uniform(0, 40, shape)),
    }[kind]()
    heights_m[0, 0] = 7.0  # of holes, too, one height is known
    return HeightGrid(
        heights_m=heights_m.astype(np.float64),
        south_deg=latitude_deg,
        west_deg=8.0,
        cell_deg=CELL_DEG,
    )


grids = st.builds(
    hilly,
    st.integers(0, 2**32),
    st.sampled_from(["noise", "cliff", "masts", "waves", "holes"]),
    st.tuples(st.integers(2, 25), st.integers(2, 25)),
    st.sampled_from([-66.0, 0.0, 47.0]),
)
steepnesses = st.sampled_from([0.05, STEEPEST, 2.0])


def places(grid: HeightGrid, shares: FloatArray) -> FloatArray:
    """(..., 2) from 0 to 1 along the grid's sides -> (..., 2) degrees."""
    last = np.array(grid.heights_m.shape) - 1.0
    return np.array([grid.south_deg, grid.west_deg]) + grid.cell_deg * last * shares


@given(grid=grids, steepest=steepnesses, seed=st.integers(0, 99))
def test_it_is_nowhere_below_the_ground_nor_steeper_than_it_may_be(grid, steepest, seed):
    over = grid.enveloped(steepest)
    rng = np.random.default_rng(seed)
    at_deg = places(grid, rng.random((400, 2)))
    above_m = over.at(at_deg) - grid.at(at_deg)
    assert np.isfinite(over.heights_m).all()
    assert above_m[~np.isnan(above_m)].min(initial=0.0) >= -1e-9
    step_deg = rng.uniform(-1.0, 1.0, (400, 2)) * grid.cell_deg * rng.choice([0.01, 0.3, 3.0])
    near_deg = np.clip(at_deg + step_deg, *places(grid, np.array([[0.001], [0.999]])))
    origin = GeoPoint.at(at_deg[0])
    away_m = np.linalg.norm(
        np.diff(degrees_to_ned(np.stack([at_deg, near_deg]), origin), axis=0), axis=-1
    )[0]
    rise_m = np.abs(over.at(near_deg) - over.at(at_deg))
    assert (rise_m <= 1.01 * steepest * away_m + 1e-6).all()


@given(grid=grids, steepest=steepnesses)
def test_it_is_no_higher_than_that_takes(grid, steepest):
    """As the plain definition has it: the highest of cones hung from all heights."""
    rows, columns = grid.heights_m.shape
    north_deg = (
        abs(grid.south_deg) if grid.south_deg < 0 else grid.south_deg + (rows - 1) * CELL_DEG
    )
    fall = (
        steepest * grid.cell_m / math.sqrt(2.0) * np.array([1.0, math.cos(math.radians(north_deg))])
    )
    places = np.argwhere(np.isfinite(grid.heights_m))
    known_m = grid.heights_m[tuple(places.T)]
    every = np.stack(np.mgrid[:rows, :columns], axis=-1)
    cones_m = known_m - np.abs(every[:, :, None] - places) @ fall
    np.testing.assert_allclose(grid.enveloped(steepest).heights_m, cones_m.max(axis=-1), atol=1e-9)


def test_level_ground_stays_as_it_is_to_the_last_bit():
    heights_m = np.full((30, 20), 512.3)
    grid = HeightGrid(heights_m=heights_m, south_deg=47.0, west_deg=8.0, cell_deg=CELL_DEG)
    assert (grid.enveloped(0.1).heights_m == heights_m).all()
    assert heights_m.flags.writeable
    hill_m = heights_m.copy()
    hill_m[3, 4] = 600.0
    hill = HeightGrid(heights_m=hill_m, south_deg=47.0, west_deg=8.0, cell_deg=CELL_DEG)
    hill.enveloped(0.1)
    assert (hill_m != heights_m).sum() == 1, "the file's own heights stay what they are"


@pytest.mark.parametrize("latitude_deg", [-66.0, 0.0, 47.0])
@pytest.mark.parametrize("cell_deg", [1e-4, 1e-3])
def test_in_the_local_frame_it_is_where_the_terrain_is(latitude_deg, cell_deg):
    """To 10 cm over 10 km; and beyond the grid it goes on as at the edge."""
    side = 100
    slopes_m = 0.3 * cell_deg * 111e3 * np.add.outer(np.arange(side), -np.arange(side))
    south_deg, west_deg = latitude_deg - side / 2 * cell_deg, 8.0 - side / 2 * cell_deg
    grid = HeightGrid(heights_m=slopes_m, south_deg=south_deg, west_deg=west_deg, cell_deg=cell_deg)
    origin = GeoPoint(latitude_deg=latitude_deg, longitude_deg=8.0, altitude_m=488.0)
    terrain = Terrain(grid, origin, np.array([40.0, -30.0]), -3.2)
    envelope = Envelope(grid, origin, terrain.level_down_m)
    half_m = 0.45 * side * cell_deg * 111e3 * np.array([1.0, math.cos(math.radians(latitude_deg))])
    places_m = np.random.default_rng(0).uniform(-half_m, half_m, (500, 2))
    np.testing.assert_allclose(envelope.down_m(places_m), terrain.down_m(places_m), atol=0.1)
    far_m = 4.0 * half_m * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1], [1e6, 0]])
    corners_m = terrain.level_down_m - slopes_m[[-1, -1, 0, 0], [-1, 0, -1, 0]]
    down_m = envelope.down_m(far_m)
    assert np.isfinite(down_m).all()
    np.testing.assert_allclose(down_m[:4], corners_m, atol=1e-6)


def test_a_flight_in_the_corner_of_a_large_grid_is_where_the_terrain_is():
    """A fit to all of the grid would be metres aside there."""
    side, cell_deg = 1500, 3.0 / 3600.0
    slopes_m = 0.3 * cell_deg * 111e3 * np.add.outer(np.arange(side), -np.arange(side))
    grid = HeightGrid(heights_m=slopes_m, south_deg=59.0, west_deg=8.0, cell_deg=cell_deg)
    origin = GeoPoint(latitude_deg=60.2, longitude_deg=8.05, altitude_m=0.0)
    terrain = Terrain(grid, origin, np.zeros(2), 0.0)
    envelope = Envelope(grid, origin, terrain.level_down_m)
    places_m = np.random.default_rng(0).uniform(-2000.0, 2000.0, (500, 2))
    np.testing.assert_allclose(envelope.down_m(places_m), terrain.down_m(places_m), atol=0.1)
