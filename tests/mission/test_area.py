"""A mission's area: which keys go together, what is wrong with a field, and where it lies."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import shapely

from dronemon.errors import MissionFileError
from dronemon.feasibility import load_checked
from dronemon.frames import AreaFrame, GeoPoint, geo_to_ned
from dronemon.mission import Mission, MissionFile, load_mission
from dronemon.mission.field import lay_field
from dronemon.outline import Field

RESERVE = Path(__file__).parents[2] / "missions" / "reserve.geojson"
HOME = GeoPoint(latitude_deg=47.397742, longitude_deg=8.545594, altitude_m=488.0)
ORIGIN = GeoPoint(latitude_deg=47.3980, longitude_deg=8.5450, altitude_m=480.0)
SQUARE_M = "[[-100, -50], [100, -50], [100, 150], [-100, 150]]"
SQUARE_DEG = "[[47.39, 8.54], [47.39, 8.55], [47.4, 8.55], [47.4, 8.54]]"
COVER_M = "[[-900, -900], [900, -900], [900, 900], [-900, 900]]"
BOW_TIE = "[[0, 0], [100, 100], [100, 0], [0, 100]]"
RADIUS = "sensor_radius_m: 20"


@pytest.fixture
def load(tmp_path: Path):
    shutil.copy(RESERVE, tmp_path)

    def written(area: str, how=load_mission) -> Mission:
        path = tmp_path / "m.yaml"
        path.write_text(f"area: {{{area}}}\ntargets: [{{name: a, appearance: cow}}]\n")
        return how(path).mission

    return written


def _check(path: Path) -> MissionFile:
    return load_checked(str(path), {}, None)


def _lay(mission: Mission, home: GeoPoint = HOME) -> Field:
    north_m, east_m, _ = geo_to_ned(home, ORIGIN)
    frame = AreaFrame(
        centre_ned_m=(float(north_m), float(east_m)),
        ground_down_m=0.0,
        side_m=mission.area.side_m,
        heading_rad=math.radians(mission.area.heading_deg),
        cruise_speed_m_s=5.0,
    )
    return lay_field(mission.area, frame, ORIGIN)


def test_one_au_is_ten_sensor_radii(load):
    assert load("").area.side_m == 200.0
    square = load("side_m: 150")
    assert (square.area.side_m, square.sensor_radius_m) == (150.0, 15.0)
    for area in (RADIUS, f"{RADIUS}, side_m: 200", f"{RADIUS}, polygon_m: {SQUARE_M}"):
        mission = load(area)
        assert (mission.area.side_m, mission.sensor_radius_m) == (200.0, 20.0)


@pytest.mark.parametrize(
    "area",
    ["", RADIUS, f"file: reserve.geojson, {RADIUS}", f"polygon_m: {SQUARE_M}, {RADIUS}"],
)
def test_a_mission_that_was_written_with_its_defaults_is_the_same(load, area: str):
    """As a run's folder has it, from which a flight goes on."""
    mission = load(area)
    assert Mission.model_validate(mission.model_dump(mode="json", exclude_none=True)) == mission


@pytest.mark.parametrize(
    ("area", "key", "words"),
    [
        (f"polygon_m: {SQUARE_M}", "area", "polygon_m needs sensor_radius_m"),
        ("file: reserve.geojson, side_m: 200", "area", "file needs sensor_radius_m"),
        ("sensor_radius_m: 0", "area.sensor_radius_m", "greater than or equal to 1"),
        (f"{RADIUS}, side_m: 300", "area", "side_m 300 is not ten times sensor_radius_m, 20"),
        (
            f"file: a.kml, polygon_m: {SQUARE_M}, {RADIUS}",
            "area",
            "give one of file and polygon_m",
        ),
        (f"polygon_m: {BOW_TIE}, {RADIUS}", "area.polygon_m", "crosses or touches itself"),
        (
            f"polygon_deg: [[0, 0], [99, 0], [0, 1]], {RADIUS}",
            "area.polygon_deg",
            "corner 2: latitude 99 is beyond 90 degrees; are latitude and longitude swapped?",
        ),
        (
            f"polygon_deg: [[0, 0], [60, 60], [60, 0]], {RADIUS}",
            "area.polygon_deg",
            "km across",
        ),
        (f"polygon_m: [[0, 0], [9, 9]], {RADIUS}", "area.polygon_m", "three different corners"),
        (f"polygon_m: [3, [9, 9]], {RADIUS}", "area.polygon_m[0]", "3 cannot be this: The same in"),
        (f"polygon_m: [[0, 0, 0], [9, 9]], {RADIUS}", "area.polygon_m[0]", "too_long|at most 2"),
        (f"polygon_m: [[0, x], [9, 9]], {RADIUS}", "area.polygon_m[0][1]", "valid number"),
        (f"polygon_m: [[0, .nan], [9, 9]], {RADIUS}", "area.polygon_m[0][1]", "finite"),
        ("no_fly: [{name: hut}]", r"area.no_fly[0]", "give polygon_deg or polygon_m"),
        (
            f"no_fly: [{{name: hut, polygon_m: {BOW_TIE}}}]",
            "area.no_fly[0].polygon_m",
            "crosses or touches itself",
        ),
        (
            "no_fly: [{name: hut, polygon_m: [[0, 0], 7]}]",
            "area.no_fly[0].polygon_m[1]",
            "7 cannot be this: Its corners in order",
        ),
        (f"no_fly: [{{polygon_m: {SQUARE_M}}}]", "area.no_fly[0].name", "is missing"),
        (f"no_fly: [{{name: a, polygon: {SQUARE_M}}}]", "area.no_fly[0].polygon", "did you mean"),
        (f"no_fly: [{{name: hut, polygon_m: {COVER_M}}}]", "area.no_fly", "'hut' covers all of"),
        (f"file: none.kml, {RADIUS}", "area.file", "none.kml: no such file"),
        (f"file: m.yaml, {RADIUS}", "area.file", ".yaml is no outline"),
        (
            f"file: reserve.geojson, {RADIUS}, latitude_deg: 8.545, longitude_deg: 47.4",
            "area.file",
            "km from area.latitude_deg and longitude_deg; are its latitude and longitude swapped",
        ),
        (
            f"polygon_deg: {SQUARE_DEG}, {RADIUS}, latitude_deg: -47.4, longitude_deg: -171.5",
            "area.polygon_deg",
            "km from area.latitude_deg",
        ),
        (
            f"file: reserve.geojson, {RADIUS}, no_fly: [{{name: hut, polygon_deg: "
            "[[8.54, 47.39], [8.54, 47.4], [8.55, 47.4]]}]",
            "area.file",
            "no-fly 'hut' is 5",
        ),
    ],
)
def test_what_is_wrong_is_told_by_key(load, area: str, key: str, words: str):
    with pytest.raises(MissionFileError) as caught:
        load(area)
    told = str(caught.value)
    assert f"m.yaml:1: {key}: " in told
    assert any(word in told for word in words.split("|")), told
    assert len(told.splitlines()) == 1, told


@pytest.mark.parametrize(
    ("area", "key"),
    [
        (f"file: reserve.geojson, {RADIUS}", "file"),
        (f"polygon_m: {SQUARE_M}, {RADIUS}", "polygon_m"),
        ("no_fly: [{name: hut, polygon_m: [[0, 0], [9, 0], [9, 9]]}]", "no_fly"),
    ],
)
def test_what_is_no_square_is_not_flown_yet(load, area: str, key: str):
    with pytest.raises(MissionFileError) as caught:
        load(area, _check)
    assert str(caught.value).endswith(f"area.{key}: fields that are no squares cannot be flown yet")


def test_a_radius_that_the_camera_cannot_show_is_told_by_its_key(load):
    with pytest.raises(MissionFileError, match=r"or make area.sensor_radius_m smaller"):
        load(f"polygon_m: {SQUARE_M}, sensor_radius_m: 25", _check)
    with pytest.raises(MissionFileError, match=r"sensor_radius_m: 90 m is too large for the cam"):
        load(f"polygon_m: {SQUARE_M}, sensor_radius_m: 90", _check)


def test_metres_are_east_and_north_of_the_centre_whatever_the_heading(load):
    hut = "no_fly: [{name: hut, polygon_m: [[10, 0], [30, 0], [30, 20]]}]"
    field = _lay(load(f"polygon_m: {SQUARE_M}, {hut}, heading_deg: 30, {RADIUS}"))
    home_m = geo_to_ned(HOME, ORIGIN)[:2]
    expected_m = [(-50, -100), (-50, 100), (150, 100), (150, -100)]
    assert field.border_ned_m - home_m == pytest.approx(np.array(expected_m))
    (zone,) = field.no_fly
    assert zone.name == "hut"
    assert zone.corners_ned_m - home_m == pytest.approx(np.array([(0, 10), (0, 30), (20, 30)]))


def test_a_square_is_a_field_that_the_heading_turns(load):
    field = _lay(load("side_m: 100, heading_deg: 90"))
    corners_m = field.border_ned_m - geo_to_ned(HOME, ORIGIN)[:2]
    assert corners_m == pytest.approx(np.array([(50, -50), (-50, -50), (-50, 50), (50, 50)]))


def test_degrees_metres_and_a_file_lie_in_the_same_place(load):
    """The shipped reserve again, in each of the mission's own ways."""
    of_file = _lay(load(f"file: reserve.geojson, {RADIUS}"))
    home_m = geo_to_ned(HOME, ORIGIN)[:2]
    metres = (of_file.border_ned_m - home_m)[:, ::-1].tolist()
    in_metres = _lay(load(f"polygon_m: {metres}, {RADIUS}"))
    assert in_metres.border_ned_m == pytest.approx(of_file.border_ned_m, abs=0.01)
    hut = "no_fly: [{name: hut, polygon_m: [[0, 0], [9, 0], [9, 9]]}]"
    both = _lay(load(f"file: reserve.geojson, {RADIUS}, {hut}"))
    assert [zone.name for zone in both.no_fly] == ["lake", "farm", "hut"]
    assert not shapely.Polygon(both.no_fly[0].corners_ned_m).contains(shapely.Point(home_m))


def test_what_home_alone_can_tell_is_told_when_it_is_known(load):
    mission = load(f"polygon_deg: {SQUARE_DEG}, {RADIUS}")
    _lay(mission)
    swapped = GeoPoint(latitude_deg=8.545594, longitude_deg=47.397742)
    with pytest.raises(MissionFileError, match=r"the field is \d+ km from home; .* swapped"):
        _lay(mission, swapped)
    covered = load(
        f"polygon_deg: {SQUARE_DEG}, {RADIUS}, no_fly: [{{name: hut, polygon_m: {COVER_M}}}]"
    )
    with pytest.raises(MissionFileError, match="'hut' covers all"):
        _lay(covered)
