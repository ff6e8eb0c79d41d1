"""A mission's area: which keys go together, what is wrong with a field, and where it lies."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import shapely
from hills import hill, write_hills

from dronemon.errors import MissionFileError
from dronemon.feasibility import flight_facts, load_checked
from dronemon.frames import AreaFrame, GeoPoint, geo_to_ned
from dronemon.mission import (
    Mission,
    MissionFile,
    load_mission,
    mission_arena,
    mission_obstacles,
)
from dronemon.mission.field import flown_over, lay_field
from dronemon.outline import Field, read_outline
from dronemon.runner.inspection import lay_area

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
    ("altitude_m", "stand_off_m", "is_over"),
    [(45, 10, False), (69.9, 10, False), (70, 10, True), (62, 2, True), (61.9, 2, False)],
)
def test_a_zone_of_some_height_is_flown_over_from_well_above_it(
    load, altitude_m: float, stand_off_m: float, is_over: bool
):
    hut = "{name: hut, below_m: 60, polygon_m: [[-20, -20], [20, -20], [20, 20]]}"
    tower = "{name: tower, polygon_m: [[50, 50], [60, 50], [60, 60]]}"
    mission = load(f"no_fly: [{hut}, {tower}]")
    flight = mission.flight.model_copy(
        update={"altitude_m": altitude_m, "stand_off_m": stand_off_m}
    )
    mission = mission.model_copy(update={"flight": flight})
    assert len(mission_arena(mission).no_fly_au) == 2 - is_over
    assert flown_over(mission) == ["hut"] * is_over
    told = flight_facts(mission)["area"]
    assert ("1 no-fly zones, and 1 that it flies over (hut)." in told) == is_over


def test_trees_are_flown_over_and_hide_the_ground(load):
    """Of a height alone a zone reaches as far up as they do, 35 m below the flight at 45 m."""
    wood, shed = (
        f"{{name: {name}, height_m: {height_m}, polygon_m: {corners}}}"
        for name, height_m, corners in (
            ("wood", 35, "[[-20, -20], [20, -20], [20, 20]]"),
            ("shed", 36, "[[50, 50], [60, 50], [60, 60]]"),
        )
    )
    mission = load(
        f"no_fly: [{wood}, {{name: pond, polygon_m: [[0, 60], [9, 60], [9, 69]]}}, {shed}]"
    )
    assert flown_over(mission) == ["wood"]
    assert len(mission_arena(mission).no_fly_au) == 2
    obstacles = mission_obstacles(mission)
    assert [obstacle.height_m for obstacle in obstacles] == [35.0, 36.0]
    np.testing.assert_allclose(obstacles[0].corners_au, [[0.4, 0.4], [0.6, 0.4], [0.6, 0.6]])
    told = flight_facts(mission)["area"]
    assert "what stands in 2 zones, up to 36 m high, hides the ground behind it" in told
    assert mission_obstacles(load("")) == ()
    pond = load("no_fly: [{name: pond, polygon_m: [[0, 60], [9, 60], [9, 69]]}]")
    assert "stands" not in flight_facts(pond)["area"]


def test_over_hills_no_flight_goes_over_what_stands_somewhere(load):
    """Its top is above the ground there; the flight is above the take-off's, or its own."""
    wood = "name: wood, below_m: 12, polygon_m: [[-20, -20], [20, -20], [20, 20]]"
    for terrain, height, count in (
        ("", "", 0),
        ("", ", height_m: 12", 0),
        ("terrain: hills.asc, ", "", 0),
        ("terrain: hills.asc, ", ", height_m: 12", 1),
    ):
        area = f"{terrain}no_fly: [{{{wood}{height}}}]"
        assert len(mission_arena(load(area)).no_fly_au) == count


def test_heights_are_those_of_the_area_where_that_is_known(load, tmp_path: Path):
    middle = GeoPoint(latitude_deg=-2.0, longitude_deg=34.0)
    write_hills(tmp_path / "hills.asc", middle, hill(10.0, 40.0))  # 330 m across
    for place, known in (
        ("", True),
        ("latitude_deg: -2.0, longitude_deg: 34.0, ", True),
        ("latitude_deg: -2.001, longitude_deg: 34.0, ", False),
        ("latitude_deg: 34.0, longitude_deg: -2.0, ", False),
    ):
        area = f"{place}side_m: 200, terrain: hills.asc"
        if known:
            told = flight_facts(load(area, _check))["ground"]
            above = "taken off there, 45 to 55 m below the flight, 5.8 to 7.1 pixels a metre"
            assert (above in told) == bool(place)
            assert ("preflight compares it" in told) == (not place)
        else:
            with pytest.raises(MissionFileError, match=r"hills\.asc: has no height at"):
                load(area, _check)


def test_a_polygon_across_180_degrees_may_leap(load):
    leaps = "[[-17, 179.998], [-17, -179.998], [-16.996, -179.998], [-16.996, 179.998]]"
    goes_on = leaps.replace("-179.998", "180.002")
    for place in ("", ", latitude_deg: -17, longitude_deg: -180"):
        one, other = (
            load(f"polygon_deg: {corners}, {RADIUS}{place}") for corners in (leaps, goes_on)
        )
        outlines_au = [mission_arena(mission).outline_au for mission in (one, other)]
        np.testing.assert_allclose(*outlines_au, atol=1e-9)
    assert (
        "around -16.99800, 180.00000"
        in flight_facts(load(f"polygon_deg: {leaps}, {RADIUS}"))["area"]
    )


def test_a_rangefinder_knows_of_nothing_that_stands_on_the_ground(load):
    wood = "no_fly: [{name: wood, height_m: 12, polygon_m: [[0, 60], [9, 60], [9, 69]]}]"
    load(f"rangefinder: true, {wood.replace('height_m: 12, ', '')}")
    with pytest.raises(MissionFileError, match=r"area\.rangefinder: knows nothing of what stands"):
        load(f"rangefinder: true, {wood}")


def test_a_zone_that_covers_all_may_be_flown_over(load):
    roofs = f"no_fly: [{{name: roofs, below_m: 20, polygon_m: {COVER_M}}}]"
    assert mission_arena(load(roofs)).no_fly_au == ()
    with pytest.raises(MissionFileError, match=r"nothing of the field is left .* \(roofs\)"):
        load(f"{roofs.replace('20', '40', 1)}")


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
        (
            f"no_fly: [{{name: a, below_m: 0, polygon_m: {SQUARE_M}}}]",
            "area.no_fly[0].below_m",
            "greater than 0",
        ),
        (
            f"no_fly: [{{name: a, below_m: 9, height_m: 9.5, polygon_m: {SQUARE_M}}}]",
            "area.no_fly[0]",
            "height_m 9.5 is more than below_m 9",
        ),
        (f"no_fly: [{{name: a, polygon: {SQUARE_M}}}]", "area.no_fly[0].polygon", "did you mean"),
        (f"no_fly: [{{name: hut, polygon_m: {COVER_M}}}]", "area.no_fly", "'hut' covers all of"),
        (f"file: none.kml, {RADIUS}", "area.file", "none.kml: no such file"),
        (f"file: m.yaml, {RADIUS}", "area.file", ".yaml is no outline"),
        (
            f"file: reserve.geojson, {RADIUS}, latitude_deg: 8.545, longitude_deg: 47.4",
            "area.file",
            "reserve.geojson: the field is 5469 km from area.latitude_deg and longitude_deg; are "
            "its latitude and longitude swapped",
        ),
        (
            f"polygon_deg: {SQUARE_DEG}, {RADIUS}, latitude_deg: -47.4, longitude_deg: -171.5",
            "area.polygon_deg",
            "km from area.latitude_deg",
        ),
        (
            f"file: reserve.geojson, {RADIUS}, no_fly: [{{name: hut, polygon_deg: "
            "[[8.54, 47.39], [8.54, 47.4], [8.55, 47.4]]}]",
            "area.no_fly",
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
    "area",
    [
        f"file: reserve.geojson, {RADIUS}",
        f"polygon_m: {SQUARE_M}, {RADIUS}",
        "no_fly: [{name: hut, polygon_m: [[0, 0], [9, 0], [9, 9]]}]",
    ],
)
def test_the_drone_keeps_clear_of_border_and_zones(load, area: str):
    mission = load(area, _check)
    arena, au_m = mission_arena(mission), mission.area.side_m
    places_m = au_m * arena.sample_free(500, np.random.default_rng(0))
    border = shapely.Polygon(au_m * arena.outline_au).exterior
    zones = shapely.union_all([shapely.Polygon(au_m * np.array(z)) for z in arena.no_fly_au])
    away_m = shapely.distance(shapely.GeometryCollection([border, zones]), shapely.points(places_m))
    assert away_m.min() > mission.flight.clearance_m - 1e-6
    assert mission.flight.clearance_m == pytest.approx(0.25 * 25.0 / 2.0 + 1.0 + 1.5)


def test_an_area_in_au_is_the_same_wherever_home_is(load):
    """So that start, roadmap and targets drawn in it are, and a run can go on from elsewhere."""
    mission = load(f"file: reserve.geojson, {RADIUS}")
    low, high = mission_arena(mission).bounds
    np.testing.assert_allclose((low + high) / 2.0, 0.5, atol=1e-3)
    homes = [HOME, GeoPoint(latitude_deg=47.41, longitude_deg=8.53)]
    for home in homes:
        frame = lay_area(mission, home, home, 0.0)
        assert frame.arena == mission_arena(mission)
        for corner_deg, corner_au in zip(
            read_outline(str(RESERVE)).border_deg, frame.arena.outline_au, strict=False
        ):
            place = frame.au_to_geo(corner_au, home)
            off_m = geo_to_ned(GeoPoint.at(corner_deg), place)[:2]
            assert np.hypot(*off_m) < 0.15  # one frame is turned against the other by this little


@pytest.mark.parametrize(
    ("area", "flight", "words"),
    [
        ("", "start_au: [2, 0.5]", "flight.start_au: [2.0, 0.5] is not where the drone may be"),
        ("no_fly: [{name: hut, polygon_m: [[-9, -9], [9, -9], [9, 9], [-9, 9]]}]",
         "start_au: [0.5, 0.5]", "not where the drone may be"),
        (f"polygon_m: [[0, 0], [400, 0], [400, 11], [0, 11]], {RADIUS}", "",
         "area.polygon_m: nothing of the field is left to fly in: the drone keeps 6 m"),
        (f"polygon_m: [[0, 0], [400, 0], [400, 150], [150, 150], [150, 10], [140, 10], [140, 150],"
         f" [0, 150]], {RADIUS}", "", "35% of where it may fly cannot be reached"),
    ],
)  # fmt: skip
def test_what_cannot_be_flown_to_is_told(tmp_path: Path, area: str, flight: str, words: str):
    path = tmp_path / "m.yaml"
    path.write_text(
        f"area: {{{area}}}\nflight: {{{flight}}}\ntargets: [{{name: a, appearance: cow}}]\n"
    )
    with pytest.raises(MissionFileError) as caught:
        load_mission(path)
    assert words in str(caught.value)


def test_a_learned_policy_is_for_the_square(load):
    with pytest.raises(MissionFileError, match="learned on a square, and cannot fly another"):
        load(f"polygon_m: {SQUARE_M}, {RADIUS}}}\nplanner: {{kind: stamp", _check)


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
    with pytest.raises(MissionFileError, match="give both alike"):
        load(f"file: reserve.geojson, {RADIUS}, {hut}")
    place = f"latitude_deg: {HOME.latitude_deg}, longitude_deg: {HOME.longitude_deg}"
    both = _lay(load(f"file: reserve.geojson, {RADIUS}, {hut}, {place}"))
    assert [zone.name for zone in both.no_fly] == ["lake", "farm", "hut"]
    assert not shapely.Polygon(both.no_fly[0].corners_ned_m).contains(shapely.Point(home_m))


def test_a_field_far_from_home_is_refused(load):
    mission = load(f"polygon_deg: {SQUARE_DEG}, sensor_radius_m: 18")
    lay_area(mission, HOME, ORIGIN, 0.0)
    swapped = GeoPoint(latitude_deg=8.545594, longitude_deg=47.397742)
    with pytest.raises(MissionFileError, match=r"the field is \d+ km from home; .* swapped"):
        lay_area(mission, swapped, swapped, 0.0)
