"""A patrol longer than a battery: landed, a flight waits for a fresh one and then goes on."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import virtual_time
from fake_link import ORIGIN, FakeCamera, FakeLink
from flights import Blind, Listener, Shuttle

from dronemon.errors import RecordError, VehicleError
from dronemon.events import Audience, Noted, Progressed
from dronemon.frames import ned_to_geo
from dronemon.mission import Mission, load_mission
from dronemon.mission.checks import battery_problem
from dronemon.recorder import LINE_FILES, RunFolder, RunRecorder
from dronemon.runner import relay as relay_module
from dronemon.runner.flight import FlightResult
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.preparation import FlightSetup
from dronemon.runner.relay import REQUEST_FILE, Relay
from dronemon.runner.status import ask_to_go_on, status
from dronemon.runner.tally import Tally
from dronemon.sightings import Sightings
from dronemon.types import Measurement
from dronemon.vehicle import Mode, VehicleState
from dronemon.vehicle.changes import Changes, ChangesTaken

MISSION = """
name: small
area: {side_m: 100}
flight: {altitude_m: 22, cruise_speed_m_s: 5, horizon_au: 3, start_au: [0.5, 0.4], relay: RELAY}
targets:
  - {name: Bella, appearance: cow, prior_au: [0.4, 0.6]}
simulation: {faults: [swap=60]}
"""
LIMIT_S, LANDED_S = 300.0, 40.0
Act = Callable[["Wait"], None]


@pytest.fixture(autouse=True)
def _short_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay_module, "WAIT_LIMIT_S", LIMIT_S)


class Wait:
    """A wait for a battery, after a flight that took a picture; the vehicle is at hand."""

    def __init__(self, folder: Path, kind: str = "automatic") -> None:
        (folder / "small.yaml").write_text(MISSION.replace("RELAY", kind))
        self.file = load_mission(folder / "small.yaml")
        self.mission: Mission = self.file.mission
        self.folder = RunFolder(path=folder / "run")
        self.interrupts, self.watch = Interrupts(), Listener()
        self.links: list[FakeLink] = []
        self.took_s = 0.0
        self.landed: FlightResult | None = None
        self.tally = Tally(start_s=0.0, sightings=Sightings(np.full((1, 2), np.nan)))
        self.picture()
        self.on_link: Callable[[FakeLink], None] = lambda link: None

    def picture(self) -> None:
        unseen = np.full((1, 2), np.nan)
        here = np.array([0.5, 0.5])
        at_au = 0.1 * (1 + len(self.tally.sightings))
        measurement = Measurement(
            time_au=at_au, agent_au=here, seen=np.array([False]), target_au=unseen
        )
        self.tally.sightings.add(measurement)
        self.tally.measure(20.0 * at_au, 10.0, ())

    def result(self, **changes: object) -> FlightResult:
        usual = {
            "outcome": "battery low",
            "has_flown": True,
            "is_landed": True,
            "last_seen": None,
            "landing_error_m": 0.1,
            "landing_battery": 0.16,
            "tally": self.tally,
            "error": None,
        }
        return FlightResult(**(usual | changes))

    @contextlib.asynccontextmanager
    async def connect(self) -> AsyncIterator[FakeLink]:
        link = FakeLink()
        link.vehicle.battery = 0.15
        self.links.append(link)
        self.on_link(link)
        async with link:
            yield link

    def goes_on(self, act: Act = lambda wait: None, *, at_s: float = 60.0) -> bool:
        """-> whether it goes on; what happens meanwhile is done once, after a while."""
        return virtual_time.run(self._goes_on(act, at_s))

    async def _goes_on(self, act: Act, at_s: float) -> bool:
        loop = asyncio.get_running_loop()
        loop.call_later(at_s, act, self)
        link = FakeLink()
        link.vehicle.time_s = LANDED_S
        async with link:
            pass  # the flight is over
        with RunRecorder.create(self.mission, out=self.folder.path, needed_bytes=0) as record:
            setup = FlightSetup(
                file=self.file,
                link=link,
                camera=FakeCamera(link, 640, 480),
                detector=Blind(),
                planner=Shuttle(),
                priors_au=np.full((1, 2), np.nan),
                record=record,
                audience=Audience((self.watch,)),
                interrupts=self.interrupts,
                folder=self.folder.path,
            )
            answer = await Relay(setup, self.connect).goes_on(self.result(), self.landed)
        self.took_s = loop.time()
        return answer


def fresh(wait: Wait, level: float | None = 0.9) -> None:
    wait.links[-1].vehicle.battery = level


def test_a_fresh_battery_is_waited_for_and_seen_five_times(tmp_path):
    wait = Wait(tmp_path)
    assert wait.goes_on(fresh)
    assert 64.0 <= wait.took_s <= 66.0
    assert "change it" in wait.watch.text("fresh battery")
    assert wait.watch.texts("goes on with a fresh one") == 1


@pytest.mark.lengthy
def test_a_level_that_jumps_or_is_too_low_is_not_fresh(tmp_path):
    wait = Wait(tmp_path)

    def flicker(wait: Wait) -> None:
        level = wait.links[-1].vehicle.battery
        fresh(wait, 0.49 if level == 0.9 else 0.9)
        asyncio.get_running_loop().call_later(3.0, flicker, wait)

    assert not wait.goes_on(flicker)
    assert wait.took_s == pytest.approx(LIMIT_S, abs=1.0)


@pytest.mark.lengthy
def test_a_vehicle_that_is_not_at_rest_is_not_taken(tmp_path):
    wait = Wait(tmp_path)

    def take(link: FakeLink) -> None:
        link.vehicle.is_armed, link.vehicle.battery = True, 0.9

    wait.on_link = take
    assert not wait.goes_on()


def _fly_off(wait: Wait) -> None:
    """With a fresh battery in, a pilot flies it away, and lands it there a minute later."""
    vehicle = wait.links[-1].vehicle
    vehicle.battery, vehicle.is_armed, vehicle.intent = 0.9, True, Mode.POSITION
    vehicle.position = [80.0, 0.0, -10.0]

    def land() -> None:
        vehicle.is_armed, vehicle.position = False, [80.0, 0.0, 0.0]

    asyncio.get_running_loop().call_later(60.0, land)


def _arm_for_a_moment(wait: Wait) -> None:
    vehicle = wait.links[-1].vehicle
    vehicle.is_armed = True
    asyncio.get_running_loop().call_later(3.0, setattr, vehicle, "is_armed", False)
    asyncio.get_running_loop().call_later(60.0, fresh, wait)


def _carry_off(wait: Wait) -> None:
    wait.links[-1].vehicle.position[1] = 30.0
    fresh(wait)


@pytest.mark.lengthy
@pytest.mark.parametrize("act", [_fly_off, _arm_for_a_moment, _carry_off])
@pytest.mark.parametrize("has_word", [False, True])
def test_what_somebody_flew_or_moved_meanwhile_takes_off_at_a_persons_word(tmp_path, act, has_word):
    wait = Wait(tmp_path)

    def do(wait: Wait) -> None:
        act(wait)
        request = wait.folder.path / REQUEST_FILE
        if has_word:
            asyncio.get_running_loop().call_later(150.0, request.touch)

    assert wait.goes_on(do) == has_word
    assert wait.watch.texts("was flown or moved meanwhile") == 1
    assert "takes off" in wait.watch.text("waiting")


@pytest.mark.lengthy
def test_where_it_stands_is_told_by_the_globe_not_by_a_frame_that_begins_anew(tmp_path):
    def carried_m(north_m: float, frame_m: float, folder: Path) -> Wait:
        wait = Wait(_made(folder))

        def prepare(link: FakeLink) -> None:
            link.origin = ned_to_geo(np.array([frame_m, 0.0, 0.0]), ORIGIN)
            link.vehicle.battery, link.vehicle.position = 0.9, [north_m - frame_m, 0.0, 0.0]

        wait.on_link = prepare
        return wait

    assert carried_m(3.0, 500.0, tmp_path / "drift").goes_on()
    assert not carried_m(500.0, 500.0, tmp_path / "away").goes_on()


def test_as_long_as_its_place_is_not_known_it_stays_on_the_ground(tmp_path):
    wait = Wait(tmp_path)

    def swap(link: FakeLink) -> None:
        link.vehicle.battery, link.vehicle.is_position_good = 0.9, False

    wait.on_link = swap
    assert wait.goes_on(lambda wait: setattr(wait.links[-1].vehicle, "is_position_good", True))
    assert wait.took_s > 60.0
    phases = {event.phase for event in wait.watch.events if isinstance(event, Progressed)}
    assert "waiting for a fresh battery, and a good position" in phases


def test_other_programs_are_kept_from_it_during_the_wait(tmp_path):
    wait, refused = Wait(tmp_path), []

    def claim(wait: Wait) -> None:
        with Changes(wait.links[-1], print) as second, pytest.raises(ChangesTaken) as caught:
            second.claim()
        refused.append(caught)
        fresh(wait)

    assert wait.goes_on(claim)
    assert len(refused) == 1
    with Changes(wait.links[-1], print) as after:
        after.claim()


def test_a_vehicle_that_another_program_has_is_not_waited_for(tmp_path):
    wait = Wait(tmp_path)
    with Changes(SimpleNamespace(state=VehicleState(hardware="fake")), print) as other:
        other.claim()
        assert not wait.goes_on(fresh)
    assert wait.links == []
    assert wait.watch.texts("another program flies or changes") == 1


def test_ctrl_c_ends_the_wait_at_once(tmp_path):
    wait = Wait(tmp_path)
    assert not wait.goes_on(lambda wait: wait.interrupts.request())
    assert wait.took_s == 60.0
    assert wait.watch.texts("a person ended the wait") == 1


def test_a_simulator_that_is_gone_is_not_waited_for(tmp_path):
    wait = Wait(tmp_path)

    def end(wait: Wait) -> None:
        wait.interrupts.give_up()
        wait.links[-1].is_silent = True

    assert not wait.goes_on(end)
    assert wait.took_s < 80.0


def test_a_vehicle_that_is_switched_off_meanwhile_is_met_again(tmp_path):
    wait = Wait(tmp_path)

    def switch_off(wait: Wait) -> None:
        wait.links[-1].is_silent = True
        wait.on_link = lambda link: setattr(link.vehicle, "battery", 1.0)

    assert wait.goes_on(switch_off)
    assert len(wait.links) == 2
    assert wait.watch.texts("still waiting: nothing heard") == 1


@pytest.mark.parametrize(
    "change",
    [
        {"outcome": "completed"},
        {"outcome": "pilot"},
        {"is_landed": False},
        {"error": RecordError("full")},
        {"tally": None},
    ],
)
def test_only_a_flight_that_lacked_nothing_else_goes_on(tmp_path, change):
    wait = Wait(tmp_path)
    usual = wait.result
    wait.result = lambda: usual(**change)
    assert not wait.goes_on()
    assert wait.links == []


def test_a_battery_that_brought_no_picture_is_the_last(tmp_path):
    wait = Wait(tmp_path)
    wait.tally.num_before = 1
    assert not wait.goes_on(fresh)
    assert wait.watch.texts("brings it no further") == 1


def test_the_wait_is_told_by_the_flights_clock_whatever_the_next_one_and_the_one_before(tmp_path):
    wait = Wait(tmp_path)
    wait.tally.times_s.append(900.0)  # before an earlier reboot
    wait.on_link = lambda link: setattr(link.vehicle, "time_s", 70.0)
    assert wait.goes_on(fresh)
    noted = [event for event in wait.watch.events if isinstance(event, Noted)]
    assert [event.time_s for event in noted] == pytest.approx([LANDED_S] * 2, abs=0.1)


@pytest.mark.lengthy
def test_a_level_that_is_not_told_is_a_persons_to_judge(tmp_path):
    wait = Wait(tmp_path)
    wait.on_link = lambda link: setattr(link.vehicle, "battery", None)
    assert not wait.goes_on()
    wait = Wait(_made(tmp_path / "confirmed"), "confirmed")
    wait.on_link = lambda link: setattr(link.vehicle, "battery", None)
    assert wait.goes_on(lambda wait: (wait.folder.path / REQUEST_FILE).touch())
    assert "no level tells one" in wait.watch.text("waiting")


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


@pytest.mark.lengthy
@pytest.mark.parametrize("landed_with", [0.55, 0.8, 0.85])
def test_the_battery_that_landed_is_not_a_fresh_one(tmp_path, landed_with):
    wait = Wait(tmp_path)
    usual = wait.result
    wait.result = lambda: usual(landing_battery=landed_with)
    wait.on_link = lambda link: setattr(link.vehicle, "battery", landed_with)
    assert not wait.goes_on()
    wait = Wait(_made(tmp_path / "other"))
    wait.result = lambda: usual(landing_battery=landed_with)
    wait.on_link = lambda link: setattr(link.vehicle, "battery", landed_with)
    assert wait.goes_on(lambda wait: fresh(wait, 0.99))


@pytest.mark.lengthy
@pytest.mark.parametrize(
    "change",
    [
        {"landing_battery": 0.9},
        {"landing_battery": None},
        {"landing_error_m": 40.0},
        {"landing_error_m": None},
        {"was_taken_home": True},
    ],
)
@pytest.mark.parametrize("has_word", [False, True])
def test_where_it_cannot_be_told_or_landed_elsewhere_a_person_is_asked(tmp_path, change, has_word):
    wait = Wait(tmp_path)
    usual, request = wait.result, wait.folder.path / REQUEST_FILE
    wait.result = lambda: usual(**change)
    wait.on_link = lambda link: setattr(link.vehicle, "battery", 0.95)
    assert wait.goes_on(lambda wait: request.touch() if has_word else None) == has_word
    assert f"dronemon resume {wait.folder.path}" in wait.watch.text("waiting")


@pytest.mark.lengthy
@pytest.mark.parametrize("has_word", [False, True])
def test_a_try_that_was_refused_is_made_again_at_a_persons_word(tmp_path, has_word):
    wait = Wait(tmp_path)
    wait.landed = wait.result()
    refused = wait.result(outcome="failed", has_flown=False, error=VehicleError("no-go: GPS"))
    wait.result = lambda: refused
    request = wait.folder.path / REQUEST_FILE
    wait.on_link = lambda link: setattr(link.vehicle, "battery", 0.95)
    assert wait.goes_on(lambda wait: request.touch() if has_word else None) == has_word
    assert "takes off" in wait.watch.text("waiting")


@pytest.mark.parametrize("error", [RecordError("full"), None])
def test_a_try_that_ended_otherwise_is_the_last(tmp_path, error):
    wait = Wait(tmp_path)
    wait.landed = wait.result()
    wait.result = lambda: replace(wait.landed, outcome="failed", has_flown=False, error=error)
    assert not wait.goes_on(fresh)
    assert wait.links == []


@pytest.mark.lengthy
def test_another_vehicle_is_not_taken_for_the_one_that_landed(tmp_path):
    wait = Wait(tmp_path)
    wait.on_link = lambda link: setattr(link, "hardware", "another")
    assert not wait.goes_on(fresh)
    assert wait.watch.texts("still waiting: another vehicle answers") == 1


@pytest.mark.lengthy
def test_a_persons_word_is_waited_for_and_one_given_too_early_does_not_count(tmp_path):
    wait = Wait(tmp_path, "confirmed")
    request = wait.folder.path / REQUEST_FILE

    def change(wait: Wait) -> None:
        request.touch()
        fresh(wait)
        asyncio.get_running_loop().call_later(200.0, request.touch)

    assert wait.goes_on(change)
    assert wait.took_s == pytest.approx(260.0, abs=1.0)
    assert not request.exists()
    assert f"dronemon resume {wait.folder.path}" in wait.watch.text("waiting")


@pytest.mark.lengthy
def test_a_fresh_battery_that_does_not_stay_in_is_told(tmp_path):
    wait = Wait(tmp_path, "confirmed")

    def swap(wait: Wait) -> None:
        fresh(wait)
        asyncio.get_running_loop().call_later(20.0, fresh, wait, 0.2)

    assert not wait.goes_on(swap)
    assert [e.kind for e in wait.watch.events if isinstance(e, Noted)][1:3] == [
        "waiting",
        "fresh battery",
    ]
    assert wait.watch.texts("still waiting") == 1


def test_a_battery_carries_a_part_of_the_patrol_or_nothing(tmp_path):
    long = {"horizon_au": 900.0}

    def mission(**flight: object) -> Mission:
        whole = Wait(tmp_path).mission
        return whole.model_copy(update={"flight": whole.flight.model_copy(update=long | flight)})

    assert battery_problem(mission()) is None
    assert "the patrol" in str(battery_problem(mission(relay=None)))
    assert "the way home" in str(battery_problem(mission(endurance_min=1.0)))


class Flown:
    """A run folder that a program flies, with what it noted last."""

    def __init__(self, folder: Path, kind: str) -> None:
        wait = Wait(folder)
        self.folder, self.mission = wait.folder, wait.mission
        self.recorder = RunRecorder.create(self.mission, out=wait.folder.path, needed_bytes=0)
        self.note(kind)

    def note(self, kind: str) -> None:
        self.recorder.take(Noted(time_s=3.0, kind=kind, text="so", level="INFO", fields={}))
        self.recorder.flush()


def test_resume_is_refused_where_nobody_waits(tmp_path):
    flown = Flown(tmp_path, "patrol")
    with pytest.raises(RecordError, match="does not wait for a word: patrol: so"):
        ask_to_go_on(flown.folder)
    assert status(flown.folder, flown.mission)["program"] == "runs"
    flown.recorder.close()
    with pytest.raises(RecordError, match="dronemon fly --resume"):
        ask_to_go_on(flown.folder)
    assert "was killed" in status(flown.folder, flown.mission)["program"]
    assert not (flown.folder.path / REQUEST_FILE).exists()


def test_what_the_program_before_did_is_not_told_as_the_living_ones(tmp_path):
    flown = Flown(tmp_path, "waiting")
    flown.recorder.close()
    with RunRecorder.resume(flown.folder, flown.mission):
        table = status(flown.folder, flown.mission)
        assert (table["program"], table["doing"]) == ("runs", "gets ready")
        assert "waiting: so" in table["last event"]
        with pytest.raises(RecordError, match="does not wait for a word: it has only begun"):
            ask_to_go_on(flown.folder)


@pytest.mark.parametrize("kinds", [["battery changed"], ["fresh battery", "waiting"], [], None])
def test_resume_says_that_it_goes_on_where_it_does(tmp_path, monkeypatch, kinds):
    """A word is also thrown away, with the battery that is out again, or not heard at all."""
    flown = Flown(tmp_path, "waiting")
    request = flown.folder.path / REQUEST_FILE

    def hear() -> None:
        while not request.exists():
            pass
        request.unlink()
        for kind in kinds or []:
            flown.note(kind)

    monkeypatch.setattr("dronemon.runner.status._ANSWER_LIMIT_S", 1.0)
    program = threading.Thread(target=hear if kinds is not None else lambda: None)
    program.start()
    if kinds == ["battery changed"]:
        ask_to_go_on(flown.folder)
    else:
        with pytest.raises(RecordError, match="its last word: waiting: so"):
            ask_to_go_on(flown.folder)
    program.join()
    assert not request.exists()
    flown.recorder.close()


def test_a_word_that_is_broken_off_is_taken_back(tmp_path, monkeypatch):
    flown = Flown(tmp_path, "waiting")

    def ctrl_c(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("dronemon.runner.status.time.sleep", ctrl_c)
    with pytest.raises(KeyboardInterrupt):
        ask_to_go_on(flown.folder)
    assert not (flown.folder.path / REQUEST_FILE).exists()
    flown.recorder.close()


@pytest.mark.parametrize("kind", ["battery changed", "resuming"])
def test_a_drone_that_is_about_to_take_off_is_not_told_as_waiting(tmp_path, kind):
    flown = Flown(tmp_path, "waiting")
    flown.note(kind)
    assert status(flown.folder, flown.mission)["doing"] == "gets ready to go on"
    flown.recorder.close()


@pytest.mark.parametrize("name", ["events.jsonl", "observations.jsonl"])
def test_lines_of_another_version_are_named(tmp_path, name):
    flown = Flown(tmp_path, "waiting")
    flown.recorder.close()
    (flown.folder.path / name).write_text('{"kind": "waiting"}\n')
    with pytest.raises(RecordError, match="not those of this version"):
        status(flown.folder, flown.mission)


@pytest.mark.parametrize("name", ["mission.yaml", "summary.json", *LINE_FILES])
def test_a_folder_without_its_files_is_no_run(tmp_path, name):
    flown = Flown(tmp_path, "waiting")
    flown.recorder.close()
    (flown.folder.path / name).unlink()
    with pytest.raises(RecordError, match=f"it has no {name}"):
        RunFolder.open(flown.folder.path)
