"""A flight whose program ended goes on: from its folder, in the air or on the ground."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import virtual_time
from fake_link import FakeCamera, FakeLink
from flights import Listener

from dronemon.errors import RecordError
from dronemon.mission import MissionFile, load_mission
from dronemon.planner import Briefing, Snapshot, Waypoint
from dronemon.recorder import RunFolder, RunRecorder
from dronemon.roadmap import Roadmap
from dronemon.runner import FlightResult, FlightSetup, Interrupts, fly_mission
from dronemon.runner.history import read_history
from dronemon.runner.preparation import make_belief
from dronemon.runner.summary import summarise
from dronemon.sightings import Sightings
from dronemon.types import Detection, Pose
from dronemon.vehicle import Mode

MISSION = """
name: small
area: {side_m: 100}
flight: {altitude_m: 22, cruise_speed_m_s: 5, horizon_au: 3, start_au: [0.5, 0.4]}
targets:
  - {name: Bella, appearance: cow, prior_au: [0.4, 0.6]}
"""
PRIORS_AU = np.array([[0.4, 0.6]])


class Shuttle:
    name = "shuttle"
    snapshots: list[Snapshot]

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        self.snapshots = []

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        self.snapshots.append(snapshot)
        is_south = snapshot.position_au[1] < 0.5
        return Waypoint(position_au=np.array([0.5, 0.6 if is_south else 0.4]))


class Sometimes:
    """Sees the cow below itself in every second picture."""

    count = 0

    def detect(self, image: object, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        self.count += 1
        if self.count % 2:
            return ()
        return (Detection(appearance="cow", pixel_px=(320.0, 240.0), score=0.9),)


class Story:
    """A run folder, and flights that begin it or go on with it."""

    def __init__(self, folder: Path) -> None:
        (folder / "small.yaml").write_text(MISSION)
        self.file: MissionFile = load_mission(folder / "small.yaml")
        self.path = folder / "run"
        self.planner, self.watch = Shuttle(), Listener()
        self.link: FakeLink

    def fly(self, prepare: Callable[[FakeLink], None] = lambda link: None) -> FlightResult:
        return virtual_time.run(self._fly(prepare))

    async def _fly(self, prepare: Callable[[FakeLink], None]) -> FlightResult:
        self.planner, self.watch = Shuttle(), Listener()
        folder, mission = RunFolder(path=self.path), self.file.mission
        is_new = not self.path.exists()
        recorder = (
            RunRecorder.create(mission, out=self.path)
            if is_new
            else RunRecorder.resume(folder, mission)
        )
        with recorder:
            self.link = FakeLink()
            prepare(self.link)
            async with self.link:
                result = await fly_mission(
                    FlightSetup(
                        file=self.file,
                        link=self.link,
                        camera=FakeCamera(self.link, 640, 480),
                        detector=Sometimes(),
                        planner=self.planner,
                        priors_au=PRIORS_AU,
                        record=recorder,
                        watchers=(self.watch,),
                        interrupts=Interrupts(),
                        history=None if is_new else read_history(folder, mission, PRIORS_AU),
                    )
                )
            recorder.finish(result.outcome, {})
        return result

    def crash_after(self, num_pictures: int) -> float:
        """Leave the folder as a program that was killed then. -> vehicle time of the last line"""
        observations = self.path / "observations.jsonl"
        lines = observations.read_bytes().splitlines(keepends=True)
        observations.write_bytes(b"".join(lines[:num_pictures]) + lines[num_pictures][:40])
        last_s = float(list(RunFolder(path=self.path).observations())[-1]["time_s"])
        for name in ("events.jsonl", "decisions.jsonl"):
            file = self.path / name
            kept = [line for line in _records(file) if _time_s(line) <= last_s]
            file.write_text("".join(f"{line}\n" for line in kept))
        summary = self.path / "summary.json"
        text = summary.read_text().replace('"completed"', '"in flight"')
        summary.write_text(text)
        return last_s


def _records(file: Path) -> list[str]:
    return file.read_text().splitlines()


def _time_s(line: str) -> float:
    return float(json.loads(line)["time_s"] or 0.0)


@pytest.fixture
def story(tmp_path: Path) -> Story:
    story = Story(tmp_path)
    assert story.fly().outcome == "completed"
    return story


def _aloft(time_s: float, mode: Mode = Mode.HOLD) -> Callable[[FakeLink], None]:
    """The vehicle as its autopilot's failsafe left it."""

    def prepare(link: FakeLink) -> None:
        vehicle = link.vehicle
        vehicle.time_s, vehicle.position = time_s, [3.0, 4.0, -22.0]
        vehicle.is_armed, vehicle.intent = True, mode

    return prepare


def test_beliefs_are_those_of_an_unbroken_log(story):
    whole = read_history_anyway(story)
    story.crash_after(12)
    history = read_history(RunFolder(path=story.path), story.file.mission, PRIORS_AU)
    assert history.tally is not None
    unbroken = Sightings(PRIORS_AU)
    for measurement in whole.since(0)[:12]:
        unbroken.add(measurement)
    assert len(unbroken) == len(history.tally.sightings) == 12
    query = np.random.default_rng(0).uniform((0.0, 0.0, 1.5), (1.0, 1.0, 2.5), (50, 3))
    mission = story.file.mission
    got = make_belief(mission, history.tally.sightings).posterior(query)
    expected = make_belief(mission, unbroken).posterior(query)
    np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-9)


def read_history_anyway(story: Story) -> Sightings:
    copy = story.path.with_name("copy")
    shutil.copytree(story.path, copy)
    summary = copy / "summary.json"
    summary.write_text(summary.read_text().replace('"completed"', '"in flight"'))
    tally = read_history(RunFolder(path=copy), story.file.mission, PRIORS_AU).tally
    assert tally is not None
    return tally.sightings


@pytest.mark.parametrize("mode", [Mode.TAKEOFF, Mode.HOLD, Mode.RETURN, Mode.LAND])
def test_a_flight_goes_on_in_the_air(story, mode):
    last_s = story.crash_after(12)
    result = story.fly(_aloft(last_s + 9.0, mode))
    assert (result.outcome, result.error) == ("completed", None)
    assert story.link.commands[:2] == ["hold", "offboard"]
    assert "arm" not in story.link.commands
    assert story.watch.kinds[:4] == ["ready", "resumed", "attached", "homecoming"]
    tally = result.tally
    assert tally is not None
    assert len(tally.sightings) == tally.num_pictures_due == 30
    times_au = [m.time_au for m in tally.sightings.since(0)]
    gap_s = tally.times_s[12] - tally.times_s[11]
    assert gap_s > 9.0
    assert times_au[12] - times_au[11] == pytest.approx(gap_s * 5.0 / 100.0, abs=1e-9)
    assert result.landing_error_m == pytest.approx(0.0, abs=0.1)


def test_a_flight_goes_on_on_the_ground_after_a_reboot(story):
    story.crash_after(12)
    events = story.path / "events.jsonl"
    before = datetime.now(UTC) - timedelta(seconds=300.0)
    events.write_text(
        "".join(_replaced_wall(line, before) + "\n" for line in events.read_text().splitlines())
    )
    result = story.fly()
    assert (result.outcome, result.error) == ("completed", None)
    assert story.link.commands[0] == "arm"
    tally = result.tally
    assert tally is not None
    assert len(tally.sightings) == 30
    times_au = [m.time_au for m in tally.sightings.since(0)]
    assert times_au[12] - times_au[11] == pytest.approx(300.0 * 5.0 / 100.0, abs=2.0)


def _replaced_wall(line: str, wall: datetime) -> str:
    return json.dumps(json.loads(line) | {"wall": wall.isoformat()})


def test_statistics_count_both_parts(story):
    last_s = story.crash_after(12)
    before = [line["stretch"] for line in RunFolder(path=story.path).observations()]
    result = story.fly(_aloft(last_s + 9.0))
    summary = summarise(
        result,
        truth={},
        side_m=100.0,
        target_names=("Bella",),
        kernel=make_belief(story.file.mission, Sightings(PRIORS_AU)).kernel,
    )
    flown = summary.flown
    assert flown is not None
    assert flown.distance_m == pytest.approx(300.0, abs=3.0)
    assert flown.pictures == flown.pictures_due == 30
    assert flown.decisions > 12
    assert flown.observations == {"Bella": 6 + 9}
    assert len(result.tally.speeds_m_s) > sum(len(part["speeds_m_s"]) for part in before)


@pytest.mark.parametrize("mode", [Mode.POSITION, Mode.OFFBOARD, Mode.MISSION])
def test_what_somebody_flies_is_not_taken_over(story, mode):
    last_s = story.crash_after(12)

    def prepare(link: FakeLink) -> None:
        _aloft(last_s + 9.0, mode)(link)
        link.vehicle.setpoint_s, link.vehicle.setpoint_limit_s = last_s, 1e9
        link.vehicle.target_down_m = -100.0

    result = story.fly(prepare)
    assert not result.has_flown
    assert "nothing was commanded" in str(result.error)
    assert story.link.commands == []


def test_a_vehicle_that_has_rebooted_in_the_air_is_refused(story):
    story.crash_after(12)
    result = story.fly(_aloft(1.0))
    assert "it has rebooted" in str(result.error) or "has rebooted since" in str(result.error)
    assert story.link.commands == []


def test_a_completed_run_has_nothing_left(story):
    with pytest.raises(RecordError, match="is completed: nothing is left to fly"):
        read_history(RunFolder(path=story.path), story.file.mission, PRIORS_AU)


def test_one_program_alone_flies_a_run(story):
    story.crash_after(12)
    folder = RunFolder(path=story.path)
    with (
        RunRecorder.resume(folder, story.file.mission),
        pytest.raises(RecordError, match="is being flown by another program"),
    ):
        RunRecorder.resume(folder, story.file.mission)
    with RunRecorder.resume(folder, story.file.mission):
        assert folder.summary()["outcome"] == "in flight"
