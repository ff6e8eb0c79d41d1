from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ground_station import make_mission
from hills import hill, write_hills
from hypothesis import example, given
from hypothesis import strategies as st

from dronemon.frames import GeoPoint, geo_to_ned, ned_to_geo
from dronemon.mission.faults import Fault, parse_fault
from dronemon.types import Pose
from sim.faults import FaultSchedule, parse_camera_fault, parse_vehicle_fault
from sim.flight import HOME_NED_M, MockFlight
from sim.geodesy import LocalMap
from sim.world import TruthFile, World, home_place

ORIGIN = GeoPoint(latitude_deg=47.0, longitude_deg=8.0, altitude_m=400.0)


def test_targets_walk_at_the_speed_ratio() -> None:
    mission = make_mission(area={"side_m": 250}, flight={"cruise_speed_m_s": 4, "altitude_m": 40})
    world = World(mission)
    assert world.walked_au(100.0) == pytest.approx(0.05 * 4.0 * 100.0 / 250.0)
    assert world.walked_au(-5.0) == 0.0
    steps_au = np.linalg.norm(
        np.diff([world.targets_au(t) for t in (30.0, 30.5)], axis=0)[0], axis=1
    )
    assert (steps_au <= 0.05 * 4.0 * 0.5 / 250.0 + 1e-12).all()


def test_animals_face_where_they_walk() -> None:
    world = World(make_mission(area={"heading_deg": 30.0}))
    simulation = MockFlight(make_mission(), world)
    frame = world.frame(HOME_NED_M, ORIGIN)
    pose = _risen(simulation.autopilot.body.pose(1.0))
    world.scene(pose, frame, 1.0)
    before = world.scene(pose, frame, 41.0)
    after = world.scene(pose, frame, 41.1)
    for a, b in zip(before.animals, after.animals, strict=True):
        north, east = (y - x for x, y in zip(a.position_ned_m, b.position_ned_m, strict=True))
        assert math.hypot(north, east) == pytest.approx(0.05 * 5.0 * 0.1, rel=1e-3)
        assert math.cos(math.atan2(east, north) - a.heading_rad) > 0.999
        assert b.walked_m - a.walked_m == pytest.approx(0.025)


def _risen(pose: Pose) -> Pose:
    north_m, east_m, down_m = pose.position_ned_m
    return replace(pose, position_ned_m=(north_m, east_m, down_m - 30.0))


def test_animals_rest_until_the_first_picture_in_the_air() -> None:
    mission = make_mission()
    world = World(mission)
    pose = MockFlight(mission, world).autopilot.body.pose(14.0)
    frame = world.frame(HOME_NED_M, ORIGIN)
    world.scene(pose, frame, 14.0)  # the camera is tried on the ground
    at_rest = world.scene(_risen(pose), frame, 20.0)
    starts = frame.au_to_ned(world.targets_au(0.0))
    for animal, start in zip(at_rest.animals, starts, strict=True):
        assert animal.position_ned_m == pytest.approx(tuple(start), abs=1e-3)
    later = world.scene(_risen(pose), frame, 23.0)
    moved = [
        math.dist(a.position_ned_m, b.position_ned_m)
        for a, b in zip(at_rest.animals, later.animals, strict=True)
    ]
    assert moved == pytest.approx([0.25 * 3.0] * 2, rel=0.05)


def test_area_is_around_home_or_its_coordinates() -> None:
    home = World(make_mission()).frame((5.0, 6.0, 7.0), ORIGIN)
    assert home.centre_ned_m == (5.0, 6.0)
    assert home.ground_down_m == 7.0
    place = ned_to_geo(np.array([100.0, -50.0, 0.0]), ORIGIN)
    area = {"latitude_deg": place.latitude_deg, "longitude_deg": place.longitude_deg}
    frame = World(make_mission(area=area)).frame((5.0, 6.0, 7.0), ORIGIN)
    assert frame.centre_ned_m == pytest.approx((100.0, -50.0), abs=1e-3)


def test_mock_stands_at_the_areas_coordinates() -> None:
    mission = make_mission(area={"latitude_deg": -33.9, "longitude_deg": 18.4})
    autopilot = MockFlight(mission, World(mission)).autopilot
    latitude, longitude, _ = autopilot.map.to_geo(autopilot.body.position)
    assert (latitude, longitude) == pytest.approx((-33.9, 18.4), abs=1e-6)


@given(
    st.floats(-90.0, 90.0),
    st.sampled_from([-180.0, -179.9999, -0.0001, 0.0, 8.5, 179.9999, 180.0]),
    st.tuples(st.floats(-2000.0, 2000.0), st.floats(-2000.0, 2000.0), st.floats(-200.0, 50.0)),
)
@example(90.0, 0.0, (500.0, 300.0, -35.0))
@example(-90.0, 180.0, (-500.0, 300.0, -35.0))
def test_a_place_that_the_mock_tells_is_where_it_is_anywhere_on_earth(
    latitude_deg: float, longitude_deg: float, place: tuple[float, float, float]
) -> None:
    """Of what MAVLink carries, whole numbers of 1e-7 degrees, `frames` makes the same place."""
    origin = GeoPoint(latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=400.0)
    local = LocalMap(origin)
    latitude, longitude, altitude = local.to_geo(place)
    assert abs(latitude) <= 90.0
    assert abs(longitude) <= 180.0
    assert local.to_ned(latitude, longitude, altitude) == pytest.approx(place, abs=1e-2)
    told = GeoPoint(
        latitude_deg=round(latitude * 1e7) / 1e7,
        longitude_deg=round(longitude * 1e7) / 1e7,
        altitude_m=round(altitude * 1e3) / 1e3,
    )
    radius_m, away_m = 6.33e6, math.hypot(*place[:2])
    there, spread_m = geo_to_ned(told, origin), away_m * abs(place[2]) / radius_m
    assert there[:2] == pytest.approx(place[:2], abs=0.01 + spread_m)
    assert there[2] - place[2] == pytest.approx(away_m**2 / (2.0 * radius_m), abs=0.02)


def test_truth_file_has_a_line_for_each_scene(tmp_path: Path) -> None:
    mission = make_mission()
    simulation = MockFlight(mission, World(mission))
    path = tmp_path / "truth.jsonl"
    with TruthFile(path) as truth:
        truth.write(simulation.scene())
        first = json.loads(path.read_text(encoding="utf-8"))
    assert first["agent_au"] == pytest.approx([0.5, 0.5])
    np.testing.assert_allclose(first["targets_au"], World(mission).targets_au(0.0))
    assert first["position_ned_m"] == list(HOME_NED_M)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("silence@60+10", Fault(kind="silence", at_s=60.0, duration_s=10.0)),
        ("gps@5.5", Fault(kind="gps", at_s=5.5)),
        ("battery=0.1@120", Fault(kind="battery", at_s=120.0, value=0.1)),
        ("gps", Fault(kind="gps")),
        ("pilot+3", Fault(kind="pilot", duration_s=3.0)),
        ("misdate=-2@1", Fault(kind="misdate", at_s=1.0, value=-2.0)),
        ("COM_DISARM_LAND=-1", Fault(kind="COM_DISARM_LAND", value=-1.0)),
    ],
)
def test_fault_is_read(text: str, fault: Fault) -> None:
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    "text",
    [
        *("", "storm@3", "gps@", "gps@x", "gps=1@3", "battery@3", "battery=2@3", "reboot@3+1"),
        *("loss", "loss=1.5", "NO_SUCH_THING", "Gps", "gps@-1"),
    ],
)
def test_bad_fault_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"is not|takes"):
        parse_fault(text)


def test_a_fault_must_fit_what_is_simulated() -> None:
    assert parse_vehicle_fault("GF_ACTION=3").value == 3.0
    with pytest.raises(ValueError, match="no parameter NO_SUCH_THING"):
        parse_vehicle_fault("NO_SUCH_THING=1")
    assert parse_camera_fault("blank+3").duration_s == 3.0
    with pytest.raises(ValueError, match="only the camera"):
        parse_camera_fault("gps@3")


def test_a_mission_lists_faults() -> None:
    simulation = {"faults": ["battery=0.5", "gps@3"]}
    mission = make_mission(simulation=simulation)
    flight = MockFlight(mission, World(mission))
    flight.step()
    assert flight.faults.active == {"battery": 0.5}
    assert flight.autopilot.battery_level == 0.5
    with pytest.raises(ValueError, match="is not KIND"):
        make_mission(simulation={"faults": ["storm"]})


def test_faults_switch_on_and_off_in_order() -> None:
    seen: list[tuple[str, float | None]] = []
    texts = ("gps@2+3", "battery=0.2@4", "gps@8", "deaf+0.5")
    schedule = FaultSchedule(
        [parse_fault(text) for text in texts], lambda kind, value: seen.append((kind, value))
    )
    schedule.advance(10.0, is_armed=False)
    assert seen == [("deaf", 1.0)]
    for time_s in (10.0, 11.9, 14.0):
        schedule.advance(time_s, is_armed=True)
    assert seen[1:] == [("deaf", None), ("gps", 1.0), ("battery", 0.2)]
    schedule.add(parse_fault("reboot"))
    schedule.advance(30.0, is_armed=True)
    assert seen[4:] == [("gps", 1.0), ("reboot", 1.0), ("gps", None)]


def test_a_terrain_is_below_the_vehicle_and_below_each_animal(tmp_path: Path) -> None:
    """A slope that rises 20 m in 100 m to the north, wherever the local frame's origin is."""
    home = ned_to_geo(HOME_NED_M, ORIGIN)
    write_hills(tmp_path / "ground.asc", home, lambda north, east: 0.2 * north + 0.0 * east)
    mission = make_mission(area={"terrain": str(tmp_path / "ground.asc"), "side_m": 100})
    world = World(mission)
    frame = world.frame(HOME_NED_M, ORIGIN)
    places_m = np.array([[0.0, 0.0], [50.0, 0.0], [-25.0, 40.0]]) + HOME_NED_M[:2]
    below_m = world.ground_down_m(places_m, frame)
    assert below_m == pytest.approx([-3.2, -13.2, 1.8], abs=0.05)
    assert world.ground_down_m(np.array([1e5, 0.0]), frame) == -3.2
    pose = Pose(
        time_s=1.0,
        position_ned_m=(HOME_NED_M[0] + 30.0, HOME_NED_M[1], -50.0),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=(0.0, 0.0, 0.0),
    )
    scene = world.scene(pose, frame, 1.0)
    assert scene.frame.ground_down_m == pytest.approx(-9.2, abs=0.05)
    for animal in scene.animals:
        higher_m = 0.2 * (animal.position_ned_m[0] - pose.position_ned_m[0])
        assert animal.up_m == pytest.approx(higher_m, abs=0.05)


def test_the_mock_does_not_land_where_the_ground_is_lower(tmp_path: Path) -> None:
    """It flies down into a hollow, below the height of its take-off."""
    down = hill(-30.0, 30.0, (0.0, 60.0))
    write_hills(tmp_path / "ground.asc", home_place(make_mission()), down, cells=100)
    mission = make_mission(area={"terrain": str(tmp_path / "ground.asc")})
    flight = MockFlight(mission, World(mission))
    body = flight.autopilot.body
    body.position[:] = [HOME_NED_M[0], HOME_NED_M[1] + 60.0, -3.2 + 10.0]
    for _ in range(30):
        flight.step()
    deep_m = 30.0 * (1.0 - math.exp(-2.0))
    assert body.ground_down_m == pytest.approx(-3.2 + deep_m, abs=0.2)
    assert not body.is_on_ground
