"""A flight whose program ended goes on: from its folder, in the air or on the ground."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import virtual_time
from fake_link import ORIGIN, FakeCamera, FakeLink
from flights import Listener

from dronemon.clock import machine_time
from dronemon.errors import RecordError
from dronemon.events import Audience
from dronemon.frames import GeoPoint, ned_to_geo
from dronemon.mission import MissionFile, load_mission
from dronemon.planner import Briefing, Snapshot, Waypoint
from dronemon.recorder import RunFolder, RunRecorder
from dronemon.roadmap import Roadmap
from dronemon.runner.flight import FlightResult, fly_mission
from dronemon.runner.history import History, Newest, read_history, read_newest
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.preparation import FlightSetup, make_belief
from dronemon.runner.summary import summarise
from dronemon.runner.tally import Tally
from dronemon.sightings import Sightings
from dronemon.types import Detection, Pose
from dronemon.vehicle import Mode
from dronemon.vehicle.changes import Changes, ChangesTaken
from dronemon.vehicle.fence_items import FenceItem, polygon_items

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
        self.num_told = len(briefing.sightings or ())

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
        self.fence: tuple[FenceItem, ...] = ()  # that of the flight, on a vehicle in the air
        self.on_note: Callable[[str], None] = lambda kind: None

    def fly(self, prepare: Callable[[FakeLink], None] = lambda link: None) -> FlightResult:
        return virtual_time.run(self._fly(prepare))

    async def _fly(self, prepare: Callable[[FakeLink], None]) -> FlightResult:
        self.planner, self.watch = Shuttle(), Listener()
        self.watch.on_note = lambda kind: self.on_note(kind)
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
            if self.link.vehicle.is_armed:
                self.link.vehicle.fence = self.fence
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
                        audience=Audience((self.watch,)),
                        interrupts=Interrupts(),
                        folder=self.path,
                        history=None if is_new else read_history(folder, mission, PRIORS_AU),
                    )
                )
            recorder.finish(result.outcome, {})
        return result

    def see_fence(self) -> None:
        """Find out what fence the flight was given."""
        ready = next(e for e in RunFolder(path=self.path).events() if e["kind"] == "ready")
        laid = [ned_to_geo(np.array([*corner, 0.0]), ORIGIN) for corner in ready["fence_ned_m"]]
        self.fence = polygon_items([(p.latitude_deg, p.longitude_deg) for p in laid])

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

    def pass_time(self, duration_s: float) -> None:
        """Have everything so far happen earlier."""
        wall = (datetime.now(UTC) - timedelta(seconds=duration_s)).isoformat()
        self.say(wall=wall, up_s=machine_time()[1] - duration_s)

    def gap_s(self) -> float:
        """Mission time between the last picture before a crash after 12, and the first after it."""
        times_au = [line["time_au"] for line in RunFolder(path=self.path).observations()]
        return float(times_au[12] - times_au[11]) * 100.0 / 5.0

    def add(self, kind: str) -> None:
        """Have the program that was killed have noted something last."""
        events = self.path / "events.jsonl"
        last = json.loads(_records(events)[-1])
        with events.open("a") as lines:
            lines.write(json.dumps(last | {"kind": kind, "text": ""}) + "\n")

    def say(self, **fields: object) -> None:
        """Have every event's line say something else."""
        events = self.path / "events.jsonl"
        lines = [json.dumps(json.loads(line) | fields) for line in _records(events)]
        events.write_text("".join(f"{line}\n" for line in lines))


def _records(file: Path) -> list[str]:
    return file.read_text().splitlines()


def _time_s(line: str) -> float:
    return float(json.loads(line)["time_s"] or 0.0)


REAL = "vehicle: {url: 'udpin://127.0.0.1:14540'}\n"


def _of_a_real_vehicle(story: Story) -> None:
    """Each mock has a board of its own, so the program does not ask for it."""
    path = story.path.with_name("real.yaml")
    path.write_text(MISSION + REAL)
    story.file = load_mission(path)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole flight, to be copied."""
    folder = tmp_path_factory.mktemp("flown")
    story = Story(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        assert story.fly().outcome == "completed"
    return story.path


@pytest.fixture
def story(flown: Path, tmp_path: Path) -> Story:
    story = Story(tmp_path)
    shutil.copytree(flown, story.path)
    story.pass_time(0.0)
    story.see_fence()
    return story


def _aloft(time_s: float, mode: Mode = Mode.HOLD) -> Callable[[FakeLink], None]:
    """The vehicle as its autopilot's failsafe left it."""

    def prepare(link: FakeLink) -> None:
        vehicle = link.vehicle
        vehicle.time_s, vehicle.position = time_s, [3.0, 4.0, -22.0]
        vehicle.is_armed, vehicle.intent = True, mode

    return prepare


@pytest.mark.lengthy
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


@pytest.mark.lengthy
@pytest.mark.parametrize("mode", [Mode.TAKEOFF, Mode.HOLD, Mode.RETURN, Mode.LAND])
def test_a_flight_goes_on_in_the_air(story, mode):
    last_s = story.crash_after(12)
    result = story.fly(_aloft(last_s + 9.0, mode))
    assert (result.outcome, result.error) == ("completed", None)
    assert story.link.commands[:2] == ["hold", "offboard"]
    assert "arm" not in story.link.commands
    assert story.watch.kinds[:4] == ["resuming", "resumed", "ready", "attached"]
    assert story.planner.num_told == 12
    tally = result.tally
    assert tally is not None
    assert len(tally.sightings) == tally.num_pictures_due == 30
    times_au = [m.time_au for m in tally.sightings.since(0)]
    gap_s = tally.times_s[12] - tally.times_s[11]
    assert gap_s > 9.0
    assert times_au[12] - times_au[11] == pytest.approx(gap_s * 5.0 / 100.0, abs=1e-9)
    assert result.landing_error_m == pytest.approx(0.0, abs=0.1)


def _on_the_ground(time_s: float, **parameters: float) -> Callable[[FakeLink], None]:
    def prepare(link: FakeLink) -> None:
        link.vehicle.time_s = time_s
        link.vehicle.parameters |= parameters

    return prepare


def _goes_on_300_s_later(story: Story) -> None:
    result = story.fly(_on_the_ground(60.0))
    assert (result.outcome, result.error) == ("completed", None)
    assert story.link.commands[0] == "arm"
    assert story.planner.num_told == 12
    tally = result.tally
    assert tally is not None
    assert len(tally.sightings) == 30
    times_au = [m.time_au for m in tally.sightings.since(0)]
    assert times_au[12] - times_au[11] == pytest.approx(300.0 * 5.0 / 100.0, abs=2.0)


@pytest.mark.lengthy
def test_a_flight_goes_on_on_the_ground_after_a_reboot(story):
    story.crash_after(12)
    story.pass_time(300.0)
    _goes_on_300_s_later(story)


@pytest.mark.lengthy
def test_a_try_that_was_refused_after_a_reboot_changes_nothing(story):
    story.crash_after(12)
    story.pass_time(300.0)
    refused = story.fly(_on_the_ground(50.0, COM_OBL_RC_ACT=6.0))
    assert "no-go" in str(refused.error)
    _goes_on_300_s_later(story)


def test_a_reboot_that_ended_a_flight_is_no_other_than_one_after_it(story):
    story.crash_after(12)
    story.pass_time(300.0)
    boot, up_s = machine_time()
    now = {"time_s": 1.0, "wall": datetime.now(UTC).isoformat(), "boot": boot, "up_s": up_s}
    rebooted = now | {"kind": "outcome", "text": ""}
    with (story.path / "events.jsonl").open("a") as events:
        events.write(json.dumps(rebooted) + "\n")
    _goes_on_300_s_later(story)


DAY = timedelta(days=1)


@pytest.mark.lengthy
@pytest.mark.parametrize("step", [-DAY, DAY])
def test_a_wall_clock_that_was_set_is_not_time_that_passed(story, step):
    last_s = story.crash_after(12)
    story.say(wall=(datetime.now(UTC) + step).isoformat())
    result = story.fly(_aloft(last_s + 9.0))
    assert (result.outcome, result.error) == ("completed", None)
    assert 9.0 < result.tally.times_s[12] - result.tally.times_s[11] < 60.0


def test_after_a_restart_of_the_machine_the_wall_clock_tells_what_has_passed(story):
    story.crash_after(12)
    then = datetime.now(UTC) - timedelta(seconds=300.0)
    story.say(boot="that of then", up_s=1e6, wall=then.isoformat())
    _goes_on_300_s_later(story)


@pytest.mark.lengthy
@pytest.mark.parametrize("is_off", [False, True])
def test_a_wall_clock_that_is_behind_after_a_restart_is_told(story, is_off):
    last_s = story.crash_after(12)
    story.say(boot="that of then", up_s=1e6, wall=(datetime.now(UTC) + DAY).isoformat())
    result = story.fly(_on_the_ground(1.0) if is_off else _aloft(last_s + 9.0))
    assert (result.outcome, result.error) == ("completed", None)
    told = story.watch.text("clock")
    assert f"taken as {'0 s' if is_off else 'what the vehicle'}" in told
    assert "set the clock" in told
    assert 9.0 < story.gap_s() < 60.0


@pytest.mark.lengthy
@pytest.mark.parametrize("passed_s", [0.0, 300.0])
def test_a_wall_clock_that_goes_on_after_a_restart_is_not_told(story, passed_s):
    story.crash_after(12)
    then = datetime.now(UTC) - timedelta(seconds=passed_s)
    story.say(boot="that of then", up_s=1e6, wall=then.isoformat())
    result = story.fly(_on_the_ground(1.0))
    assert (result.outcome, result.error) == ("completed", None)
    assert "clock" not in story.watch.kinds


@pytest.mark.parametrize(
    ("prepare", "words"),
    [
        ({"failsafe": Mode.LAND}, "a failsafe of the autopilot lands it"),
        ({"failsafe": Mode.RETURN, "battery": 0.16}, "on its way down with what its battery has"),
        ({"intent": Mode.RETURN, "battery": 0.16}, "on its way down with what its battery has"),
    ],
)
def test_what_comes_down_for_a_reason_is_left_to_come_down(story, prepare, words):
    last_s = story.crash_after(12)

    def come_down(link: FakeLink) -> None:
        _aloft(last_s + 9.0)(link)
        for name, value in prepare.items():
            setattr(link.vehicle, name, value)

    result = story.fly(come_down)
    assert not result.has_flown
    assert words in str(result.error)
    assert "wait until it is down, then resume" in str(result.error)
    assert story.link.commands == []


def test_a_failsafe_that_begins_to_land_it_meanwhile_is_left_to_land_it(story):
    last_s = story.crash_after(12)

    def prepare(link: FakeLink) -> None:
        _aloft(last_s + 9.0)(link)
        land = partial(setattr, link.vehicle, "failsafe", Mode.LAND)
        story.on_note = lambda kind: land() if kind == "ready" else None

    result = story.fly(prepare)
    assert "a failsafe of the autopilot lands it" in str(result.error)
    assert story.link.commands == []


def test_the_return_of_a_killed_programs_vehicle_is_taken_over(story):
    last_s = story.crash_after(12)

    def prepare(link: FakeLink) -> None:
        _aloft(last_s + 9.0)(link)
        link.vehicle.failsafe = Mode.RETURN

    assert story.fly(prepare).outcome == "completed"


@pytest.mark.lengthy
@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.LAND])
def test_a_pilot_who_took_it_wins_also_over_the_next_program(story, mode):
    last_s = story.crash_after(12)
    story.add("control taken")
    low = _aloft(last_s + 9.0, mode)

    def prepare(link: FakeLink) -> None:
        low(link)
        link.vehicle.position[2] = -1.0 if mode is Mode.LAND else -22.0

    result = story.fly(prepare)
    assert not result.has_flown
    assert "a pilot took control" in str(result.error)
    assert story.link.commands == []
    assert story.fly(_on_the_ground(last_s + 99.0)).outcome == "completed"


def test_a_pilot_who_gave_it_back_has_no_more_say(story):
    last_s = story.crash_after(12)
    story.add("control taken")
    story.add("control given back")
    assert story.fly(_aloft(last_s + 9.0)).outcome == "completed"


@pytest.mark.lengthy
def test_a_fence_that_is_gone_is_told_in_the_air(story):
    last_s = story.crash_after(12)
    story.fence = ()
    assert story.fly(_aloft(last_s + 9.0)).outcome == "completed"
    assert "it does not keep the flight's fence" in story.watch.text("fence")
    assert story.watch.text("ready") == "the vehicle is ready"


@pytest.mark.lengthy
@pytest.mark.parametrize("hardware", ["fake", "another"])
def test_an_area_is_laid_where_it_was_on_the_globe(story, hardware):
    last_s = story.crash_after(12)

    def prepare(link: FakeLink) -> None:
        link.hardware, link.vehicle.time_s = hardware, last_s + 9.0
        north = replace(ORIGIN, latitude_deg=ORIGIN.latitude_deg + 0.001)
        link.origin = north if hardware == "fake" else ORIGIN

    _of_a_real_vehicle(story)
    laid = [e for e in RunFolder(path=story.path).events() if e["kind"] == "ready"]
    story.fly(prepare)
    again = [e for e in RunFolder(path=story.path).events() if e["kind"] == "ready"][len(laid) :]
    then, now = (
        ned_to_geo(np.array([*told["frame"]["centre_ned_m"], 0.0]), GeoPoint(**told["origin"]))
        for told in (laid[0], again[0])
    )
    assert now.latitude_deg == pytest.approx(then.latitude_deg, abs=1e-7)
    assert now.longitude_deg == pytest.approx(then.longitude_deg, abs=1e-7)
    assert story.watch.texts("another one than flew") == (hardware == "another")


def test_another_vehicle_in_the_air_is_not_taken_over(story):
    last_s = story.crash_after(12)

    def prepare(link: FakeLink) -> None:
        _aloft(last_s + 9.0)(link)
        link.hardware = "another"

    _of_a_real_vehicle(story)
    result = story.fly(prepare)
    assert "is another one" in str(result.error)
    assert story.link.commands == []


def test_what_mends_a_refusal_goes_on_with_the_run(story):
    story.crash_after(12)
    refused = story.fly(_on_the_ground(50.0, COM_OBL_RC_ACT=6.0))
    assert f"same command with: --resume {story.path} --set COM_OBL_RC_ACT=" in str(refused.error)


def test_statistics_count_both_parts(story):
    last_s = story.crash_after(12)
    before = [line["stretch"] for line in RunFolder(path=story.path).observations()]
    result = story.fly(_aloft(last_s + 9.0))
    summary = summarise(
        result,
        truth=(),
        mission=story.file.mission,
        place_of=lambda position_au: None,
    )
    flown = summary.flown
    assert flown is not None
    assert flown.distance_m == pytest.approx(300.0, abs=3.0)
    assert flown.pictures == flown.pictures_due == 30
    assert flown.decisions > 12
    assert flown.watched["Bella"].num_seen == 6 + 9
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


@pytest.mark.parametrize("prepare", [_aloft, _on_the_ground])
def test_what_another_program_flies_is_left_alone(story, prepare):
    last_s = story.crash_after(12)

    async def fly_it() -> Changes:
        async with FakeLink() as link:
            await link.wait_ready(10.0)
            changes = Changes(link, print)
            changes.claim()
            return changes

    with virtual_time.run(fly_it()):
        result = story.fly(prepare(last_s + 9.0))
    assert not result.has_flown
    assert "another program flies or changes this vehicle" in str(result.error)
    assert story.link.commands == []


def test_a_vehicle_is_ours_alone_also_when_it_was_met_in_the_air(story):
    refused = []

    def claim(kind: str) -> None:
        if kind == "homecoming":
            with Changes(story.link, print) as second, pytest.raises(ChangesTaken) as caught:
                second.claim()
            refused.append(caught)

    def prepare(link: FakeLink) -> None:
        _aloft(last_s + 9.0)(link)
        story.watch.on_note = claim

    last_s = story.crash_after(12)
    assert story.fly(prepare).outcome == "completed"
    assert len(refused) == 1


def test_a_vehicle_that_has_rebooted_in_the_air_is_refused(story):
    story.crash_after(12)
    result = story.fly(_aloft(1.0))
    assert "it has rebooted" in str(result.error) or "has rebooted since" in str(result.error)
    assert story.link.commands == []


def test_a_completed_run_has_nothing_left(story):
    with pytest.raises(RecordError, match="is completed: nothing is left to fly"):
        read_newest(RunFolder(path=story.path))


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


def test_a_run_with_its_last_picture_is_completed_on_the_ground(flight):
    tally = Tally(start_s=0.0, sightings=Sightings(PRIORS_AU), num_pictures_due=8)
    newest = Newest(time_s=0.0, wall=datetime.now(UTC), boot="", up_s=0.0, start_s=0.0)
    flight.history = History(
        newest=newest,
        laid=None,
        armed=None,
        hardware=None,
        tally=tally,
        waypoint_au=None,
        node=None,
    )
    result = flight.fly()
    assert (result.outcome, result.error, result.has_flown) == ("completed", None, False)
    assert result.is_landed
    assert "did not take off again" in result.last_word
    assert result.tally is tally
    assert flight.commands == []


@pytest.mark.lengthy
def test_a_vehicle_that_lands_while_the_program_gets_ready_takes_off_again(story):
    last_s = story.crash_after(12)

    def prepare(link: FakeLink) -> None:
        _aloft(last_s + 9.0, Mode.LAND)(link)
        link.vehicle.position[2] = -1.0

    result = story.fly(prepare)
    assert (result.outcome, result.error) == ("completed", None)
    assert story.link.commands[0] == "arm"
    assert len(result.tally.sightings) == 30
