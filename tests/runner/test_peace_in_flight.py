"""Flights that leave animals in peace: around where they are believed to be, whatever plans."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
import shapely
from flights import Flight, comes_home

from dronemon.events import Measured, Moved, Noted
from dronemon.frames import ground_to_pixel
from dronemon.guard import Reason
from dronemon.mission import load_mission, mission_arena
from dronemon.mission.schema import Camera
from dronemon.planner import Snapshot, Waypoint, create_planner
from dronemon.types import Detection, FloatArray, Pose

KEPT_OFF_M = 10.0
KEEP_OFF = f", keep_off: {{distance_m: {KEPT_OFF_M}, below_m: 60}}"
MISSION = f"""
name: peace
area: {{side_m: 200}}
flight: {{altitude_m: 45, cruise_speed_m_s: 5, horizon_au: 3, start_au: [0.5, 0.4]}}
targets:
  - {{name: Bella, appearance: cow, prior_au: [0.4, 0.6]{KEEP_OFF}}}
"""
"""A flight's setup says, too, that Bella is there before take-off."""


@dataclass
class Walker:
    """A cow on a circle about (0.5, 0.5) au, above which home is, and an eye that finds it."""

    speed_m_s: float = 0.25
    radius_m: float = math.hypot(20.0, 20.0)
    begins_rad: float = 0.75 * math.pi
    is_found: bool = True

    def place_m(self, time_s: float) -> FloatArray:
        """North and east."""
        angle = self.begins_rad - self.speed_m_s * time_s / self.radius_m
        return self.radius_m * np.array([math.sin(angle), math.cos(angle)])

    def away_m(self, pose: Pose) -> float:
        """How far it is from a drone, over ground."""
        return math.dist(self.place_m(pose.time_s), pose.position_ned_m[:2])

    def detect(self, image: object, pose: Pose, ground_down_m: float) -> Sequence[Detection]:
        camera = Camera().model
        u, v = ground_to_pixel(self.place_m(pose.time_s), camera, pose, ground_down_m).tolist()
        if not (self.is_found and 0 <= u < camera.width_px and 0 <= v < camera.height_px):
            return ()
        return (Detection(appearance="cow", pixel_px=(u, v), score=0.9),)


class Visitor:
    """Asks for one place of the map after another, each until it is there, and then again."""

    name = "visitor"

    def __init__(self, *places_au: tuple[float, float]) -> None:
        self._places_au = [np.array(place_au) for place_au in places_au]
        self.asked = 0
        self.visited = 0

    def reset(self, *_: object) -> None: ...

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        self.asked += 1
        if np.linalg.norm(snapshot.position_au - self._places_au[0]) < 1e-6:
            self._places_au.append(self._places_au.pop(0))
            self.visited += 1
        return Waypoint(position_au=self._places_au[0])


class Stubborn:
    """Asks for the same place for ever, be it there or not."""

    name = "stubborn"

    def reset(self, *_: object) -> None: ...

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        off = 1e-5 if np.allclose(snapshot.position_au, [0.4, 0.6], atol=1e-6) else 0.0
        return Waypoint(position_au=np.array([0.4 + off, 0.6]))


def patrolled(flight: Flight) -> list[Pose]:
    """From the patrol's first moment to its last picture."""
    events = flight.record.events
    began = next(n for n, e in enumerate(events) if isinstance(e, Noted) and e.kind == "patrol")
    ended = max(n for n, e in enumerate(events) if isinstance(e, Measured))
    return [e.pose for e in events[began:ended] if isinstance(e, Moved)]


@pytest.fixture
def walker(flight: Flight) -> Walker:
    flight.mission_text, flight.detector = MISSION, Walker()
    return flight.detector


@pytest.mark.lengthy
@pytest.mark.parametrize("kind", ["search", "stamp", "tsp"])
def test_whatever_plans_an_animal_is_left_in_peace_and_seen(
    flight: Flight, walker: Walker, kind: str
) -> None:
    flight.planner = create_planner(kind)
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    away_m = [walker.away_m(pose) for pose in patrolled(flight)]
    assert min(away_m) > KEPT_OFF_M
    assert result.tally is not None
    assert result.tally.sightings.num_seen[0] > 3
    comes_home(flight, result)


@pytest.mark.lengthy
def test_without_it_is_flown_over(flight: Flight, walker: Walker) -> None:
    flight.mission_text = MISSION.replace(KEEP_OFF, "")
    flight.planner = create_planner("search")
    flight.fly()
    assert min(walker.away_m(pose) for pose in patrolled(flight)) < 5.0
    assert "keeps off" not in flight.record.kinds


@pytest.mark.parametrize(
    ("keep_off", "low_m", "high_m"),
    [
        ("distance_m: 10, below_m: 45", 0.0, 4.0),  # it cuts the corner there
        ("distance_m: 1, below_m: 46", 4.0, 8.0),
        ("distance_m: 10, below_m: 46", 13.0, 17.0),
    ],
)
def test_it_keeps_off_as_far_as_it_is_told_below_the_height_that_it_is_told(
    flight: Flight, walker: Walker, keep_off: str, low_m: float, high_m: float
) -> None:
    flight.mission_text = MISSION.replace(KEEP_OFF, f", keep_off: {{{keep_off}}}")
    flight.mission_text = flight.mission_text.replace("horizon_au: 3", "horizon_au: 0.7")
    walker.speed_m_s = 0.0
    flight.planner = Visitor((0.4, 0.6), (0.4, 0.4))
    flight.fly()
    assert low_m < min(walker.away_m(pose) for pose in patrolled(flight)) < high_m


def test_the_way_to_the_start_keeps_off_too(flight: Flight, walker: Walker) -> None:
    """Straight from home to there it would fly over."""
    text = flight.mission_text.replace("start_au: [0.5, 0.4]", "start_au: [0.3, 0.7]")
    flight.mission_text = text.replace("horizon_au: 3", "horizon_au: 0.2")
    walker.speed_m_s = 0.0
    flight.planner = Visitor((0.3, 0.9), (0.3, 0.7))
    flight.fly()
    flown = [e.pose for e in flight.record.events if isinstance(e, Moved)]
    began_s = patrolled(flight)[0].time_s
    away_m = [walker.away_m(p) for p in flown if p.time_s < began_s and p.position_ned_m[2] < -40]
    assert min(away_m) > KEPT_OFF_M
    assert away_m[-1] < 30.0


@pytest.mark.lengthy
def test_a_place_that_must_not_be_reached_counts_as_reached(flight: Flight, walker: Walker) -> None:
    """And the planner is told where the drone is wherever it can fly there."""
    walker.speed_m_s = 0.0
    flight.planner = Visitor((0.4, 0.6), (0.7, 0.5))
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert flight.planner.visited > 4
    assert flight.planner.asked < 40
    assert min(walker.away_m(pose) for pose in patrolled(flight)) > KEPT_OFF_M


@pytest.mark.lengthy
def test_who_asks_for_one_place_for_ever_does_not_stop_the_patrol(
    flight: Flight, walker: Walker
) -> None:
    walker.speed_m_s = 0.0
    flight.planner = Stubborn()
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert Reason.STUCK not in flight.reasons
    assert result.tally is not None
    assert result.tally.flown_m / result.tally.duration_s > 3.0
    assert min(walker.away_m(pose) for pose in patrolled(flight)) > KEPT_OFF_M


def ring(flight: Flight, away_au: float) -> None:
    """Have seven sheep stand around the start, so near to each other that no way leads out."""
    off_au = away_au * np.array(
        [[math.cos(n), math.sin(n)] for n in 2.0 * math.pi * np.arange(7) / 7.0]
    )
    flight.priors_au = 0.5 + off_au
    entry = f"{{name: sheep, appearance: sheep, count: 7{KEEP_OFF}}}"
    text = flight.mission_text.replace("start_au: [0.5, 0.4]", "start_au: [0.5, 0.5]")
    flight.mission_text = text[: text.index("  - ")] + f"  - {entry}\n"
    flight.planner = Visitor((0.9, 0.5), (0.1, 0.5))


def away_from_sheep_m(flight: Flight) -> float:
    """The least distance of the patrol, which is laid about home, from where they stand."""
    flown_m = np.array([pose.position_ned_m[:2] for pose in patrolled(flight)])
    sheep_m = 200.0 * (flight.priors_au[:, ::-1] - 0.5)
    return float(np.linalg.norm(flown_m[:, None] - sheep_m, axis=-1).min())


@pytest.mark.lengthy
def test_one_that_is_shut_in_patrols_what_is_left(flight: Flight, walker: Walker) -> None:
    ring(flight, 0.14)
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert away_from_sheep_m(flight) > KEPT_OFF_M


@pytest.mark.lengthy
def test_one_that_has_no_way_at_all_comes_home(flight: Flight, walker: Walker) -> None:
    ring(flight, 0.085)
    result = flight.fly()
    assert Reason.PLANNER_LATE in flight.reasons
    assert result.tally is not None
    assert result.tally.duration_s < 30.0
    comes_home(flight, result)


@pytest.mark.lengthy
def test_in_a_field_it_keeps_out_of_zones_too(flight: Flight, walker: Walker) -> None:
    """The animal stands where the way along the wall is."""
    border_m = [[-80, -80], [80, -80], [80, 80], [-80, 80]]
    wall_m = [[-10, -50], [-2, -50], [-2, 40], [-10, 40]]
    area = f"{{sensor_radius_m: 20, polygon_m: {border_m},"
    area += f" no_fly: [{{name: wall, polygon_m: {wall_m}}}]}}"
    flight.mission_text = MISSION.replace("{side_m: 200}", area).replace("0.5, 0.4", "0.6, 0.5")
    flight.mission_text = flight.mission_text.replace("horizon_au: 3", "horizon_au: 6")
    flight.priors_au = np.array([[0.46, 0.75]])
    walker.speed_m_s = 0.0
    walker.radius_m, walker.begins_rad = math.hypot(8, 50), math.atan2(50, -8)
    places = Visitor((0.6, 0.6), (0.35, 0.6))

    def next_waypoint(snapshot: Snapshot) -> Waypoint:
        goal_au = places.next_waypoint(snapshot).position_au
        return Waypoint(position_au=field.way(snapshot.position_au, goal_au)[0])

    flight.planner.next_waypoint = next_waypoint
    flight.path.write_text(flight.mission_text)
    field = mission_arena(load_mission(flight.path).mission)
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert places.visited > 3
    assert min(walker.away_m(pose) for pose in patrolled(flight)) > KEPT_OFF_M
    east_north_m = [pose.position_ned_m[1::-1] for pose in patrolled(flight)]
    assert shapely.LineString(east_north_m).distance(shapely.Polygon(wall_m)) > 1.0


@pytest.mark.lengthy
def test_one_that_turns_up_close_by_is_left_at_once(flight: Flight, walker: Walker) -> None:
    """It was not where it was believed to be: the first sight is the first that can be done."""
    walker.speed_m_s, walker.radius_m = 0.0, 4.0
    flight.planner = Visitor((0.5, 0.8), (0.5, 0.2))
    result = flight.fly()
    assert (result.outcome, result.error) == ("completed", None)
    told = [e for e in flight.record.events if isinstance(e, Noted) and e.kind == "keeps off"]
    assert [e.text.startswith("Bella is ") for e in told] == [True]
    nearer = [p for p in patrolled(flight) if walker.away_m(p) < KEPT_OFF_M]
    assert nearer[0].time_s < told[0].time_s < nearer[-1].time_s < told[0].time_s + 6.0
