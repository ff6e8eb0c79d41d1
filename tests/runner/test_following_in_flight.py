"""Flights over hills and hollows: how high above the ground below they are, all along."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fake_link import ORIGIN, FakeLink
from flights import MISSION, Flight, comes_home, give_back
from hills import Height, hill, write_hills

from dronemon.errors import MissionFileError, VehicleError
from dronemon.events import Moved, Noted
from dronemon.frames import ned_to_geo
from dronemon.guard import Reason
from dronemon.mission import lay_frame, load_mission
from dronemon.mission.schema import FOLLOWING_M_S
from dronemon.planner import Snapshot, Waypoint
from dronemon.runner.patrol import SETPOINT_INTERVAL_S
from dronemon.runner.relief import surface_of
from dronemon.types import FloatArray
from dronemon.vehicle import Mode, Setpoint
from dronemon.vision.heights import read_heights
from dronemon.vision.terrain import Terrain

ALTITUDE_M = 22.0
LAG_M = 0.5
"""A vehicle that climbs no faster than PX4 is so far behind where the slope changes."""


def over(flight: Flight, folder: Path, height_m: Height, *, climb_m_s: float = 1.5) -> Terrain:
    """A zigzag over ground that is followed; the vehicle climbs and sinks as fast as PX4 sinks."""
    path = folder / "ground.asc"
    write_hills(path, ORIGIN, height_m)
    read_heights.cache_clear()
    flight.mission_text = (
        MISSION.replace("side_m: 100", "side_m: 100, terrain: ground.asc")
        .replace("altitude_m: 22", "altitude_m: 22, follow_terrain: true")
        .replace("horizon_au: 0.8", "horizon_au: 3")
    )
    corners = [[0.9, 0.9], [0.5, 0.5], [0.1, 0.9], [0.2, 0.1], [0.9, 0.2]]

    def next_waypoint(snapshot: Snapshot) -> Waypoint:
        flight.planner.asked += 1
        return Waypoint(position_au=np.array(corners[flight.planner.asked % len(corners)]))

    flight.planner.next_waypoint = next_waypoint
    flight.on_link = lambda link: setattr(link.vehicle, "climb_m_s", climb_m_s)
    return Terrain(read_heights(str(path)), ORIGIN, np.zeros(2), 0.0)


def track_m(flight: Flight) -> FloatArray:
    """(P, 3) all places on patrol, but for the last ones: it returns before that is told."""
    places, is_on_patrol = [], False
    for event in flight.record.events:
        if isinstance(event, Moved) and is_on_patrol:
            places.append(event.pose.position_ned_m)
        elif isinstance(event, Noted):
            is_on_patrol = event.kind == "patrol" or (is_on_patrol and event.kind != "homecoming")
    return np.array(places[:-20])


def heights_m(flight: Flight, ground: Terrain) -> FloatArray:
    """Height above the ground below, all along the patrol."""
    places_m = track_m(flight)
    height: FloatArray = ground.down_m(places_m[:, :2]) - places_m[:, 2]
    return height


KINDS: dict[str, tuple[Height, float]] = {
    "hill": (hill(15.0, 40.0, (20.0, 10.0)), 1.6),
    "hollow": (hill(-20.0, 90.0, (45.0, 45.0)), 0.6),
    "slope": (lambda north, east: 0.16 * east + 0.0 * north, 0.6),
    "steep": (hill(18.0, 20.0, (0.0, -20.0)), 12.0),
    "cliff": (lambda north, east: np.where(east + 0.3 * north > 10.0, 9.0, 0.0), 9.5),
}
"""The ground, and by how much the patrol may be higher above it than it is told."""


@pytest.mark.lengthy
@pytest.mark.parametrize("kind", KINDS)
def test_it_is_as_high_above_the_ground_as_it_is_told_or_higher_where_that_is_steep(
    flight: Flight, tmp_path: Path, kind: str
) -> None:
    height_m, higher_m = KINDS[kind]
    ground = over(flight, tmp_path, height_m)
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert Reason.OFF_PATH not in flight.reasons
    high_m = heights_m(flight, ground)
    assert high_m.min() > ALTITUDE_M - LAG_M
    assert high_m.max() < ALTITUDE_M + higher_m
    downs_m = track_m(flight)[:, 2]
    assert np.ptp(downs_m) > 5.0, "it has climbed"
    comes_home(flight, result)


@pytest.mark.lengthy
def test_over_level_ground_it_is_one_height(flight: Flight, tmp_path: Path) -> None:
    over(flight, tmp_path, lambda north, east: 0.0 * (north + east), climb_m_s=20.0)
    sent = []
    flight.on_link = lambda link: hear_setpoints(link, sent)
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    np.testing.assert_allclose([s.position_ned_m[2] for s in sent], -ALTITUDE_M, atol=1e-9)
    assert {s.velocity_ned_m_s[2] for s in sent} == {0.0}


def hear_setpoints(link: FakeLink, sent: list[Setpoint]) -> None:
    send = link.send_setpoint

    async def hear(setpoint: Setpoint) -> None:
        sent.append(setpoint)
        await send(setpoint)

    link.send_setpoint = hear  # type: ignore[method-assign]


@pytest.mark.lengthy
def test_what_is_asked_for_is_the_height_and_how_it_changes(flight: Flight, tmp_path: Path) -> None:
    over(flight, tmp_path, hill(15.0, 40.0))
    sent: list[Setpoint] = []
    flight.on_link = lambda link: hear_setpoints(link, sent)
    flight.fly()
    sinking = np.array([setpoint.velocity_ned_m_s[2] for setpoint in sent])
    assert np.abs(sinking).max() < FOLLOWING_M_S
    assert np.ptp(sinking) > 1.0
    downs_m = np.array([setpoint.position_ned_m[2] for setpoint in sent])
    changes = np.diff(downs_m) / SETPOINT_INTERVAL_S
    assert np.percentile(np.abs(changes - sinking[1:]), 95) < 0.3


@pytest.mark.lengthy
def test_from_a_hollow_it_takes_off_to_where_its_rim_is_below(
    flight: Flight, tmp_path: Path
) -> None:
    """A round hole of 25 m at home, whose walls are too steep to be followed."""
    ground = over(
        flight,
        tmp_path,
        lambda north, east: np.where(np.hypot(north, east) < 15.0, -12.0, 0.0),
    )
    up_m: list[float] = []
    flight.when("airborne", lambda: up_m.append(-flight.link.vehicle.position[2]))
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert 12.0 + ALTITUDE_M - 4.5 < up_m[0] < 12.0 + ALTITUDE_M
    assert heights_m(flight, ground).min() > ALTITUDE_M - LAG_M


@pytest.mark.lengthy
def test_a_pilot_may_give_it_back_at_another_height_elsewhere(
    flight: Flight, tmp_path: Path
) -> None:
    ground = over(flight, tmp_path, hill(15.0, 40.0))

    def give_back_lower() -> None:
        flight.link.vehicle.position[:] = [30.0, 30.0, -8.0]
        give_back(flight)

    def take() -> None:
        flight.link.vehicle.choose(Mode.POSITION)
        flight.later(5.0, give_back_lower)

    flight.when("patrol", lambda: flight.later(6.0, take))
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert {Reason.TAKEN, Reason.GIVEN_BACK} <= flight.reasons
    assert heights_m(flight, ground)[-500:].min() > ALTITUDE_M - LAG_M


@pytest.mark.lengthy
def test_a_height_that_jumps_takes_the_ground_along(flight: Flight, tmp_path: Path) -> None:
    """The estimator is reset by 3 m: the drone stays where it is, and so do the hills."""
    ground = over(flight, tmp_path, hill(15.0, 40.0))

    def jump() -> None:
        flight.link.vehicle.position[2] += 3.0
        flight.link.jumped_down_m, flight.link.num_resets = 3.0, 1

    flight.when("patrol", lambda: flight.later(15.0, jump))
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    high_m = heights_m(flight, ground)[-1000:] + 3.0
    assert high_m.min() > ALTITUDE_M - LAG_M
    assert high_m.max() < ALTITUDE_M + 1.6


@pytest.mark.lengthy
def test_a_vehicle_that_cannot_keep_up_comes_home(flight: Flight, tmp_path: Path) -> None:
    over(flight, tmp_path, KINDS["slope"][0], climb_m_s=0.2)
    result = flight.fly()
    assert Reason.OFF_PATH in flight.reasons
    assert result.outcome == "failed"
    comes_home(flight, result)


@pytest.mark.parametrize(
    ("height_m", "parameters", "words"),
    [
        (hill(40.0, 30.0, (45.0, 45.0)), {}, "straight: hills, what stands there"),
        (hill(18.0, 30.0, (45.0, 45.0)), {"GF_MAX_VER_DIST": 37.0}, "outside this fence"),
        (hill(18.0, 60.0), {"MPC_Z_VEL_MAX_DN": 0.7}, "MPC_Z_VEL_MAX_DN allow less"),
        (hill(-150.0, 15.0, (30.0, 30.0)), {}, "fly lower, or slower, which follows steeper"),
    ],
)
def test_what_cannot_be_followed_is_refused_on_the_ground(
    flight: Flight, tmp_path: Path, height_m: Height, parameters: dict[str, float], words: str
) -> None:
    over(flight, tmp_path, height_m)
    flight.on_link = lambda link: link.vehicle.parameters.update(parameters)
    result = flight.fly()
    assert isinstance(result.error, VehicleError)
    assert words in str(result.error)
    assert flight.link.commands == []


def test_heights_are_to_be_known_wherever_it_may_fly(flight: Flight, tmp_path: Path) -> None:
    """On every way between home and the area, not on the shortest alone."""
    over(flight, tmp_path, hill(5.0, 40.0))
    flight.path.write_text(flight.mission_text)
    mission, path = load_mission(flight.path).mission, tmp_path / "ground.asc"
    frame = lay_frame(mission, (0.0, 0.0), 0.0)
    home = ned_to_geo([-140.0, 0.0, 0.0], ORIGIN)
    surface_of(mission, frame, home, ORIGIN)

    head, rows = path.read_text().splitlines()[:5], path.read_text().splitlines()[5:]
    north_m = 5.5 * (29.5 - np.arange(60))
    east_m = 3.76 * (np.arange(60) - 29.5)
    is_aside = (np.abs(north_m[:, None] + 65.0) < 6.0) & (np.abs(east_m - 35.0) < 6.0)
    assert is_aside.any()
    words = np.array([row.split() for row in rows])
    words[is_aside] = "-9999"
    path.write_text("\n".join([*head, *map(" ".join, words.tolist())]))
    read_heights.cache_clear()
    with pytest.raises(MissionFileError, match="no heights of all the area"):
        surface_of(mission, frame, home, ORIGIN)


@pytest.mark.lengthy
def test_a_fields_own_way_home_follows_the_ground(flight: Flight, tmp_path: Path) -> None:
    """Around a wall, over a hill beside it; only over home the autopilot climbs."""
    ground = over(flight, tmp_path, hill(15.0, 25.0, (-45.0, 20.0)))
    flight.mission_text = (
        flight.mission_text.replace(
            "side_m: 100",
            "sensor_radius_m: 10, polygon_m: [[-60, -60], [80, -60], [80, 60], [-60, 60]]"
            ", no_fly: [{name: wall, polygon_m: [[15, -20], [25, -20], [25, 59], [15, 59]]}]",
        )
        .replace("start_au: [0.5, 0.4]", "start_au: [0.9, 0.4]")
        .replace("au: 3", "au: 0.8")
    )

    def next_waypoint(snapshot: Snapshot) -> Waypoint:
        flight.planner.asked += 1
        return Waypoint(position_au=np.array([0.9, 0.6 if flight.planner.asked % 2 else 0.4]))

    flight.planner.next_waypoint = next_waypoint
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert Reason.THERE in flight.reasons
    places_m, high_m = track_m(flight), heights_m(flight, ground)
    assert np.linalg.norm(places_m[-1, :2]) < 10.0
    assert high_m.min() > ALTITUDE_M - LAG_M
    assert places_m[:, 2].min() < -ALTITUDE_M - 8.0, "the hill is on the way"


def test_a_vehicle_that_is_not_as_high_as_the_ground_below_it_is_refused(
    flight: Flight, tmp_path: Path
) -> None:
    """As one that has come down elsewhere, in a run that goes on with the area as it was laid."""
    over(flight, tmp_path, KINDS["slope"][0])

    def moved(link: FakeLink) -> None:
        link.vehicle.position[:2] = [0.0, 45.0]  # home is where it was: 7 m lower

    flight.on_link = moved
    result = flight.fly()
    assert isinstance(result.error, VehicleError)
    assert "hills are not where they seem" in str(result.error)
    assert "arm" not in flight.link.commands
