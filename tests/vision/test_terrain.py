"""Ground that is not flat: files of heights, rays that meet it, and errors on a slope."""

from __future__ import annotations

import math
import os
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from rasterio.transform import from_origin
from rasterio.warp import transform as warp

from dronemon.errors import CameraError, MissionFileError
from dronemon.frames import GeoPoint, geo_to_ned, ground_to_pixel
from dronemon.types import CameraModel, FloatArray, Pose
from dronemon.vision.ground_error import ground_jacobian
from dronemon.vision.heights import HeightGrid, read_heights
from dronemon.vision.surface import Plane, down_below_m
from dronemon.vision.terrain import Terrain

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.radians(90))
ORIGIN = GeoPoint(latitude_deg=-2.3, longitude_deg=34.8, altitude_m=1600.0)
HOME = np.zeros(2)
HOME_DOWN_M = 1.5
CELL_DEG = 1e-4  # 11 m
SIDE = 101
GRID = """ncols 3
nrows 2
xllcorner 34.8
yllcorner -2.3
cellsize 0.001
NODATA_value -9999
10 11 12
20 -9999 22
"""


def terrain_of(height_m) -> Terrain:
    """Of a function of north and east in metres from the origin, which is in the middle."""
    first = -0.5 * CELL_DEG * (SIDE - 1)
    degrees = first + CELL_DEG * np.arange(SIDE)
    heights_m = np.empty((SIDE, SIDE))
    for row, up in enumerate(degrees):
        for column, right in enumerate(degrees):
            at = replace(
                ORIGIN,
                latitude_deg=ORIGIN.latitude_deg + up,
                longitude_deg=ORIGIN.longitude_deg + right,
            )
            north_m, east_m, _ = geo_to_ned(at, ORIGIN)
            heights_m[row, column] = height_m(north_m, east_m)
    south, west = ORIGIN.latitude_deg + first, ORIGIN.longitude_deg + first
    grid = HeightGrid(heights_m=heights_m, south_deg=south, west_deg=west, cell_deg=CELL_DEG)
    return Terrain(grid, ORIGIN, HOME, HOME_DOWN_M)


FLAT = terrain_of(lambda north, east: 1234.0)
SLOPE = terrain_of(lambda north, east: 1000.0 + 0.3 * north - 0.2 * east)
HILLS = terrain_of(lambda n, e: 900.0 + 8.0 * math.sin(n / 40.0) * math.cos(e / 55.0))


def pose_at(height_m=60.0, attitude=(0.0, 0.0, 0.0), place=(10.0, -20.0)) -> Pose:
    return Pose(
        time_s=0.0,
        position_ned_m=(*place, HOME_DOWN_M - height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=attitude,
    )


def written(folder: Path, text: str) -> str:
    path = folder / "ground.asc"
    path.write_text(text)
    return str(path)


def test_heights_are_where_the_file_has_them(tmp_path: Path):
    """Between the middles of cells, the first row in the north."""
    grid = read_heights(written(tmp_path, GRID))
    assert grid.heights_m.tolist()[1] == [10.0, 11.0, 12.0]
    assert (grid.south_deg, grid.west_deg) == pytest.approx((-2.2995, 34.8005))
    (tmp_path / "whole").mkdir()
    whole = read_heights(written(tmp_path / "whole", GRID.replace("-9999 22", "21 22")))
    places_deg = np.array([[-2.299, 34.8007], [-2.2986, 34.802]])
    np.testing.assert_allclose(whole.at(places_deg), [15.2, 12.5])
    off_deg = np.array([[-2.2984, 34.801], [-2.299, 34.8026], [-2.299, 34.8004]])
    assert np.isnan(whole.at(off_deg)).all()
    assert np.isnan(grid.at(places_deg)).all()  # beside what is not known


def test_a_file_may_count_from_the_middle_of_a_cell(tmp_path: Path):
    grid = read_heights(written(tmp_path, GRID.replace("llcorner", "LLCENTER")))
    assert (grid.south_deg, grid.west_deg) == (-2.3, 34.8)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("ncols 3\n", "", 6, "a line `ncols NUMBER` is to come first"),
        ("xllcorner 34.8\n", "", 6, "`xllcorner or xllcenter NUMBER`"),
        ("nrows 2", "nrows 2\nnrows 2", 3, "nrows is given twice"),
        ("cellsize 0.001", "cellsize small", 5, "'small' is not one number"),
        ("cellsize 0.001", "cellsize 0", 1, "more than 0 apart"),
        ("nrows 2", "nrows 3", 7, "2 rows follow, nrows is 3"),
        ("10 11 12", "10 11", 7, "2 heights, ncols is 3"),
        ("10 11 12", "10 eleven 12", 7, "could not convert string to float"),
        ("22", "22000", 8, "22000 m is no height on Earth"),
        ("22", "nan", None, ""),
        ("22", "inf", 8, "inf m is no height"),
        ("34.8\n", "734000.0\n", 1, "which are no latitudes and longitudes"),
        ("10 11 12\n20 -9999 22", "-9999 -9999 -9999\n-9999 -9999 -9999", 7, "no heights in it"),
        ("ncols 3", "ncols 3000000000", 1, "10000000 in all at most"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_with_its_line(
    tmp_path: Path, old: str, new: str, line: int | None, words: str
):
    assert GRID.count(old) == 1
    path = written(tmp_path, GRID.replace(old, new))
    if line is None:
        read_heights(path)
        return
    with pytest.raises(MissionFileError) as failed:
        read_heights(path)
    assert str(failed.value).startswith(f"{path}:{line}: ")
    assert words in str(failed.value)


@pytest.mark.parametrize("name", ["none.asc", "none.tif", "text.asc", "ground.tif"])
def test_what_is_no_file_of_its_kind_is_told(tmp_path: Path, name: str):
    if not name.startswith("none"):
        (tmp_path / name).write_bytes(b"II*\x00\xff\xfe")
    with pytest.raises(MissionFileError, match=rf"{name}: cannot be read"):
        read_heights(str(tmp_path / name))


def geotiff(path: Path, heights_m: FloatArray, crs: str | None, transform: Affine, **more) -> str:
    size = {"width": heights_m.shape[1], "height": heights_m.shape[0], "count": 1}
    terms = {**size, "dtype": heights_m.dtype, "crs": crs, "transform": transform, **more}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # one without coordinates is meant
        with rasterio.open(path, "w", driver="GTiff", **terms) as file:
            file.write(heights_m, 1)
    return str(path)


def test_a_geotiff_in_degrees_is_the_same_as_its_ascii_grid(tmp_path: Path):
    heights_m = np.array([[10, 11, 12], [20, -9999, 22]], dtype=np.int16)
    transform = from_origin(34.8, -2.298, 0.001, 0.001)
    path = geotiff(tmp_path / "ground.tif", heights_m, "EPSG:4326", transform, nodata=-9999)
    grid, same = read_heights(path), read_heights(written(tmp_path, GRID))
    np.testing.assert_allclose(grid.heights_m, same.heights_m)
    assert (grid.south_deg, grid.west_deg, grid.cell_deg) == pytest.approx(
        (same.south_deg, same.west_deg, same.cell_deg)
    )


def test_a_geotiff_in_metres_is_brought_to_degrees(tmp_path: Path):
    """A plane that rises to the north-east, in UTM: a metre for ten each way."""
    rows, columns = np.indices((60, 80))
    heights_m = (500.0 + columns - rows).astype(np.float32)  # cells of 10 m, the north first
    transform = from_origin(700_000.0, 9_750_000.0, 10.0, 10.0)
    grid = read_heights(geotiff(tmp_path / "ground.TIFF", heights_m, "EPSG:32736", transform))
    east_m = 700_000.0 + np.arange(100, 700, 37)
    longitude, latitude = warp("EPSG:32736", "EPSG:4326", east_m, np.full_like(east_m, 9_749_750.0))
    expected = 500.0 + (east_m - 700_005.0) / 10.0 - 24.5
    got = grid.at(np.column_stack([latitude, longitude]))
    np.testing.assert_allclose(got, expected, atol=0.15)
    assert grid.cell_m == pytest.approx(10.0, rel=0.02)


@pytest.mark.parametrize(
    ("heights_m", "crs", "words"),
    [
        (np.ones((2, 2), dtype=np.float32), None, "does not say in what coordinates it is"),
        (np.full((3, 3), 9e4, dtype=np.float32), "EPSG:4326", "90000 m is no height on Earth"),
        (np.full((3, 3), np.nan, dtype=np.float32), "EPSG:4326", "there are no heights in it"),
        (np.ones((1, 3), dtype=np.float32), "EPSG:4326", "3 by 1 heights; there are to be 2"),
    ],
)
def test_what_is_wrong_with_a_geotiff_is_told(
    tmp_path: Path, heights_m: FloatArray, crs: str | None, words: str
):
    path = geotiff(tmp_path / "ground.tif", heights_m, crs, from_origin(34.8, -2.3, 0.001, 0.001))
    with pytest.raises(MissionFileError, match=rf"ground\.tif: .*{words}"):
        read_heights(path)


@pytest.mark.parametrize("path", ["/vsicurl/http://127.0.0.1:9/x.tif", "/vsizip/a.zip/x.tif"])
def test_what_is_no_file_on_disk_is_not_asked_for(path: str):
    with pytest.raises(MissionFileError, match=r"x\.tif: cannot be read: no such file"):
        read_heights(path)


@pytest.mark.parametrize("name", ["pipe.asc", "pipe.tif"])
def test_a_pipe_is_not_waited_for(tmp_path: Path, name: str):
    os.mkfifo(tmp_path / name)
    with pytest.raises(MissionFileError, match="cannot be read: no such file"):
        read_heights(str(tmp_path / name))


def test_a_geotiff_in_huge_parts_is_refused_before_it_is_read(tmp_path: Path):
    parts = {"tiled": True, "blockxsize": 4096, "blockysize": 4096, "compress": "deflate"}
    transform = from_origin(34.8, -2.3, 0.001, 0.001)
    path = geotiff(tmp_path / "ground.tif", np.ones((9, 9)), "EPSG:4326", transform, **parts)
    with pytest.raises(MissionFileError, match=r"is stored in parts of more than 10000000 heights"):
        read_heights(path)


def test_without_rasterio_a_geotiff_says_what_brings_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(MissionFileError, match=r"pip install 'dronemon\[terrain\]' brings it"):
        read_heights(str(tmp_path / "other.tif"))


def test_flat_terrain_is_a_plane():
    pixels_px, pose = (
        np.random.default_rng(1).uniform(0, 480, (50, 2)),
        pose_at(60.0, (0.2, 0.1, 1)),
    )
    plane = Plane(HOME_DOWN_M)
    np.testing.assert_allclose(
        FLAT.places(pixels_px, CAMERA, pose), plane.places(pixels_px, CAMERA, pose), atol=1e-4
    )
    np.testing.assert_allclose(
        ground_jacobian(pixels_px, CAMERA, pose, FLAT),
        ground_jacobian(pixels_px, CAMERA, pose, plane),
        atol=1e-4,
    )


@pytest.mark.lengthy
@given(
    st.floats(-40.0, 40.0),
    st.floats(-40.0, 40.0),
    st.floats(-0.3, 0.3),
    st.floats(-0.3, 0.3),
    st.floats(-3.0, 3.0),
)
def test_a_place_on_hills_is_found_from_where_it_is_seen(north, east, roll, pitch, yaw):
    """From so high that no hill hides another."""
    place_m, pose = np.array([10.0 + north, -20.0 + east]), pose_at(90.0, (roll, pitch, yaw))
    pixel_px = ground_to_pixel(place_m, CAMERA, pose, float(HILLS.down_m(place_m)))
    np.testing.assert_allclose(HILLS.places(pixel_px, CAMERA, pose), place_m, atol=1e-3)


def test_a_ridge_hides_what_is_behind_it():
    ridge = terrain_of(lambda n, e: 40.0 if 55.0 < n < 95.0 else 0.0)
    pose = pose_at(60.0, place=(0.0, 0.0))
    behind_px = ground_to_pixel(np.array([110.0, 0.0]), CAMERA, pose, HOME_DOWN_M)
    north_m, _ = ridge.places(behind_px, CAMERA, pose)
    assert 30.0 < north_m < 60.0
    assert Plane(HOME_DOWN_M).places(behind_px, CAMERA, pose)[0] == pytest.approx(110.0)


def test_rays_into_the_sky_and_off_the_grid_meet_nothing():
    pixels_px = np.array([[320.0, 0.0], [320.0, 240.0], [np.nan, 3.0]])
    met = np.isfinite(HILLS.places(pixels_px, CAMERA, pose_at(attitude=(0.0, 1.2, 0.0))))
    assert met[:, 0].tolist() == [False, True, False]
    off = pose_at(place=(5000.0, 0.0))
    assert np.isnan(HILLS.places(pixels_px, CAMERA, off)).all()
    with pytest.raises(CameraError, match="no height below the drone, 5000 m north and 0 m east"):
        down_below_m(HILLS, off)


@pytest.mark.lengthy
@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.2, -0.3, 2.0)])
@pytest.mark.parametrize("pixel_px", [(320.0, 240.0), (500.0, 100.0)])
def test_errors_on_a_slope_are_those_of_central_differences(attitude, pixel_px):
    pixel_px, pose = np.array(pixel_px), pose_at(60.0, attitude)

    def place(off: FloatArray) -> FloatArray:
        north, east, down = pose.position_ned_m
        moved = replace(
            pose,
            position_ned_m=(north + off[0], east + off[1], down - off[2]),
            attitude_rad=tuple(np.add(attitude, off[3:6])),
        )
        focal_px = CAMERA.focal_px * (1.0 + off[6])
        fov_rad = 2.0 * math.atan(CAMERA.width_px / 2.0 / focal_px)
        return SLOPE.places(pixel_px + off[7:], replace(CAMERA, horizontal_fov_rad=fov_rad), moved)

    jacobian = ground_jacobian(pixel_px, CAMERA, pose, SLOPE)
    for column in range(9):
        step = np.zeros(9)
        step[column] = 1e-3
        slope = (place(step) - place(-step)) / 2e-3
        np.testing.assert_allclose(jacobian[:, column], slope, rtol=5e-3, atol=0.02)
