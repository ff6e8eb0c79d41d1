import json
import math
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, replace
from datetime import datetime
from errno import EIO
from pathlib import Path

import numpy as np
import pytest

from dronemon.errors import RecordError
from dronemon.events import AreaLaid, Decided, Measured, Moved, Noted, Stretch
from dronemon.frames import AreaFrame, GeoPoint
from dronemon.mission import Mission, load_mission
from dronemon.mission.schema import Target
from dronemon.recorder import MISSION_FILE, RUN_FILES, RunFolder, RunRecorder
from dronemon.runner.history import measurement_of
from dronemon.types import Measurement, Pose

NAMES = ("Bella", "Zuri")
MISSION = Mission(
    name="Two animals!",
    targets=(Target(name="Bella", appearance="cow"), Target(name="Zuri", appearance="zebra")),
)

STRETCH = Stretch(
    pictured_m=10.0,
    flown_m=10.5,
    duration_s=2.0,
    pictures_due=1,
    speeds_m_s=[5.0],
    cross_track_m=[],
)
POSE = Pose(
    time_s=4.0,
    position_ned_m=(100.0, -50.0, -30.0),
    velocity_ned_m_s=(3.0, 4.0, 0.0),
    attitude_rad=(0.0, 0.0, 0.0),
)


def create(root: Path, **options: object) -> RunRecorder:
    return RunRecorder.create(MISSION, root=root, **options)  # type: ignore[arg-type]


def measurement(time_au: float = 0.1) -> Measurement:
    return Measurement(
        time_au=time_au,
        agent_au=np.array([0.25, 0.5]),
        seen=np.array([True, False]),
        target_au=np.array([[0.3, 0.55], [np.nan, np.nan]]),
    )


MEASURED = Measured(
    number=1,
    time_s=4.0,
    measurement=measurement(),
    score=np.array([0.9, np.nan]),
    pose=POSE,
    covariance_m2=np.array([[[0.3, 0.1], [0.1, 0.2]], np.full((2, 2), np.nan)]),
    error_m=np.array([1.5, np.nan]),
    battery=0.5,
    battery_needed=0.1,
    stretch=STRETCH,
)
DECIDED = Decided(
    time_s=4.5,
    time_au=0.12,
    flown_au=0.11,
    remaining_au=2.9,
    position_au=np.array([0.25, 0.5]),
    waypoint_au=np.array([0.4, 0.6]),
    node=17,
    num_measurements=1,
    decision_ms=3.5,
    details={"gain": np.array([1.0, np.inf]), "path": [1, 2]},
)


def noted(kind: str, text: str, time_s: float | None = None, **fields: object) -> Noted:
    return Noted(time_s=time_s, kind=kind, text=text, level="INFO", fields=fields)


def record_all(run: RunRecorder) -> None:
    run.take(noted("connect", "vehicle heard"))
    run.take(noted("armed", "armed", 3.0, battery=np.float32(0.5), mode="OFFBOARD"))
    run.take(MEASURED)
    run.take(DECIDED)


def test_what_things_hid_is_read_back_to_the_last_digit(tmp_path: Path) -> None:
    """Or a decision would come out otherwise than it was flown."""
    hidden_au = np.random.default_rng(0).random((72, 2))
    for told in (None, hidden_au):
        with create(tmp_path) as run:
            look = replace(measurement(), hidden_au=told)
            run.take(replace(MEASURED, measurement=look))
        (line,) = RunFolder.open(run.folder.path).observations()
        assert ("hidden_au" in line) == (told is not None)
        np.testing.assert_equal(measurement_of(line, ["Bella", "Zuri"]).hidden_au, told)


def test_everything_recorded_is_read_back(tmp_path: Path) -> None:
    with create(tmp_path) as run:
        record_all(run)
        (run.folder.rrd_path).write_bytes(b"RRF2")
        run.finish("landed", {"unc": 0.5, "jsd": float("nan"), "min_ob": np.int64(3)})
    folder = RunFolder.open(run.folder.path)
    assert folder.mission() == MISSION
    (observation,) = folder.observations()
    assert observation == {
        "number": 1,
        "time_s": 4.0,
        "wall": observation["wall"],
        "time_au": 0.1,
        "agent_au": [0.25, 0.5],
        "view_au": 0.1,
        "battery": 0.5,
        "battery_needed": 0.1,
        "stretch": asdict(STRETCH),
        "targets": {
            "Bella": {
                "seen": True,
                "position_au": [0.3, 0.55],
                "score": 0.9,
                "error_m": 1.5,
                "covariance_m2": [[0.3, 0.1], [0.1, 0.2]],
            },
            "Zuri": {"seen": False, "position_au": None, "score": None},
        },
    }
    (decision,) = folder.decisions()
    assert decision["node"] == 17
    assert decision["waypoint_au"] == [0.4, 0.6]
    assert decision["details"] == {"gain": [1.0, None], "path": [1, 2]}
    connect, armed = folder.events()
    assert connect["time_s"] is None
    assert armed["kind"] == "armed"
    assert armed["battery"] == 0.5
    assert armed["wall"].count("T") == 1
    summary = folder.summary()
    assert summary["outcome"] == "landed"
    assert summary["targets"] == list(NAMES)
    assert summary["jsd"] is None
    assert summary["min_ob"] == 3
    assert sorted(summary["files"]) == sorted(set(RUN_FILES) - {"summary.json"})
    assert folder.damaged_files() == []


@pytest.mark.parametrize(
    "origin", [(47.0, 8.0), (-33.9, -70.6), (0.0001, 179.9999), (-0.0001, -0.0001)]
)
def test_lines_say_where_on_the_globe(tmp_path: Path, origin: tuple[float, float]) -> None:
    """The vehicle 100 m north and 50 m west of the origin; Bella 200 m south, 300 m east of it."""
    area = AreaFrame(
        centre_ned_m=(-200.0, 300.0),
        ground_down_m=0.0,
        side_m=100.0,
        heading_rad=0.5,
        cruise_speed_m_s=5.0,
    )
    laid = AreaLaid(
        system_id=1,
        area=area,
        origin=GeoPoint(latitude_deg=origin[0], longitude_deg=origin[1], altitude_m=400.0),
        footprint_radius_m=10.0,
        fence_ned_m=np.zeros((4, 2)),
        nodes_au=np.zeros((2, 2)),
        edges=np.array([[0, 1]]),
    )
    with create(tmp_path) as run:
        run.take(Moved(pose=POSE))
        run.take(noted("connect", "before the area is laid"))
        run.take(laid)
        for late_s in (0.0, 0.5, 1.0, 1.5):
            run.take(Moved(pose=replace(POSE, time_s=4.0 + late_s)))
        middle = replace(measurement(), target_au=np.array([[0.5, 0.5], [np.nan, np.nan]]))
        run.take(replace(MEASURED, measurement=middle))
        run.take(replace(DECIDED, waypoint_au=np.array([0.5, 0.5])))
        run.take(noted("patrol", "on its way", 5.5))
        run.flush()
        folder = run.folder
        (observation,), (decision,) = folder.observations(), folder.decisions()
        (early, event), poses = folder.events(), list(folder.poses())
    assert "place" not in early
    assert [pose["time_s"] for pose in poses] == [4.0, 5.0]

    def offset_m(place: dict[str, float]) -> list[float]:
        """From the origin, on a sphere as large as the earth."""
        turned = (place["longitude_deg"] - origin[1] + 180.0) % 360.0 - 180.0
        shrunk = math.cos(math.radians(origin[0]))
        return [111.2e3 * (place["latitude_deg"] - origin[0]), 111.2e3 * shrunk * turned]

    for there in (poses[0], observation, event):
        assert offset_m(there["place"]) == pytest.approx([100.0, -50.0], rel=0.01)
        assert there["place"]["altitude_m"] == pytest.approx(430.0, abs=0.1)
    bella, zuri = observation["targets"]["Bella"], observation["targets"]["Zuri"]
    for there in (bella, decision):
        assert offset_m(there["place"]) == pytest.approx([-200.0, 300.0], rel=0.01)
        assert there["place"]["altitude_m"] == pytest.approx(400.0, abs=0.1)
    assert "place" not in zuri
    told, seen = (datetime.fromisoformat(line["wall"]) for line in (event, observation))
    assert (told - seen).total_seconds() == pytest.approx(1.5, abs=0.5)


def test_a_flipped_byte_is_found(tmp_path: Path) -> None:
    with create(tmp_path) as run:
        run.folder.rrd_path.write_bytes(bytes(100))
        run.finish("landed", {})
    run.folder.rrd_path.write_bytes(bytes(50) + b"\x01" + bytes(49))
    assert run.folder.damaged_files() == ["flight.rrd"]


def test_the_summary_says_in_flight_until_the_end(tmp_path: Path) -> None:
    with create(tmp_path) as run:
        assert RunFolder.open(run.folder.path).summary()["outcome"] == "in flight"


def test_two_runs_within_a_second_get_two_folders(tmp_path: Path) -> None:
    runs = [create(tmp_path) for _ in range(3)]
    for run in runs:
        run.close()
        assert "two-animals" in run.folder.path.name
    assert len({run.folder.path for run in runs}) == 3


def test_a_chosen_folder_that_holds_a_run_is_refused_unharmed(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "run"
    with create(tmp_path, out=out) as run:
        record_all(run)
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    with pytest.raises(RecordError, match="already holds a run"):
        create(tmp_path, out=out)
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before


def test_a_folder_that_cannot_be_made_is_an_error_with_the_next_step(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordError, match=r"cannot make the run folder .*file.*--out"):
        create(tmp_path, out=tmp_path / "file")
    with pytest.raises(RecordError, match="--out"):
        create(tmp_path / "file")


def test_a_full_disk_is_found_before_the_flight(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"MB are free at .*, a flight needs"):
        create(tmp_path, needed_bytes=10**18)


def test_a_write_that_fails_raises_and_leaves_whole_lines(tmp_path: Path) -> None:
    """A file size limit stands in for a full disk: both fail a write part of the way through."""

    def write(time_s: float) -> None:
        """Either call tells, as fast as the thread that writes is."""
        run.take(noted("long", "x" * 400, time_s))
        run.flush()

    with create(tmp_path) as run:
        run.take(noted("armed", "armed", 1.0))
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (300, limits[1]))
        try:
            for time_s in (2.0, 3.0):
                with pytest.raises(RecordError, match=r"events\.jsonl: File too large; free space"):
                    write(time_s)
            run.take(noted("short", "returning", 4.0))
            run.flush()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            signal.signal(signal.SIGXFSZ, ignored)
        assert run.lost_lines == 2
        run.finish("failed", {})
    assert [event["kind"] for event in run.folder.events()] == ["armed", "short"]
    assert run.folder.summary()["lost_lines"] == 2


def test_a_disk_that_takes_its_time_holds_up_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_disk_busy, is_disk_back = threading.Event(), threading.Event()

    def fsync(_: object) -> None:
        is_disk_busy.set()
        is_disk_back.wait()

    with create(tmp_path) as run:
        monkeypatch.setattr("os.fsync", fsync)
        for number in range(100):
            run.take(noted("tick", "", float(number)))
        assert is_disk_busy.wait(10.0)
        monkeypatch.setattr("dronemon.durable.SILENT_DISK_S", 0.0)
        with pytest.raises(RecordError, match=r"cannot write .*: its disk takes nothing for 0 s"):
            run.take(noted("late", ""))
        monkeypatch.undo()
        is_disk_back.set()
        run.flush()
    assert len(list(run.folder.events())) == 101
    assert run.lost_lines == 0


WRITER = """
import itertools, sys
from pathlib import Path
from dronemon.events import Noted
from dronemon.mission import Mission, load_mission
from dronemon.mission.schema import Target
from dronemon.recorder import RunRecorder
mission = Mission(targets=(Target(name="a", appearance="cow"),))
run = RunRecorder.create(mission, out=Path(sys.argv[1]))
for number in itertools.count():
    fields = {"number": number}
    run.take(Noted(time_s=float(number), kind="tick", text="x" * 200, level="INFO", fields=fields))
    run.flush()
    print(number, flush=True)
"""


def test_a_killed_run_is_readable_to_the_last_line_reported(tmp_path: Path) -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path / "run")],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parent.parent,
    )
    assert child.stdout is not None
    with child.stdout:
        for line in child.stdout:
            if int(line) == 100:
                break
        child.send_signal(signal.SIGKILL)
        reported = [100, *(int(line) for line in child.stdout if line.endswith("\n"))]
    child.wait()
    folder = RunFolder.open(tmp_path / "run")
    numbers = [event["number"] for event in folder.events()]
    assert numbers[: reported[-1] + 1] == list(range(reported[-1] + 1))
    assert folder.summary()["outcome"] == "in flight"


HUNG_WRITER = """
import os, sys, threading
from pathlib import Path
from dronemon.events import Noted
from dronemon.mission import Mission
from dronemon.mission.schema import Target
from dronemon.recorder import RunRecorder
mission = Mission(targets=(Target(name="a", appearance="cow"),))
run = RunRecorder.create(mission, root=Path(sys.argv[1]))
hang = threading.Event().wait
os.fsync = lambda _: hang()
for number in range(4):
    run.take(Noted(time_s=float(number), kind="tick", text="", level="INFO", fields={}))
print(run.folder.path, flush=True)
hang()
"""


def test_lines_outlive_a_program_that_is_killed_while_the_disk_is_busy(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HUNG_WRITER, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parent.parent,
    ) as child:
        assert child.stdout is not None
        try:
            folder = RunFolder(path=Path(child.stdout.readline().strip()))
            deadline = time.monotonic() + 10.0
            while len(list(folder.events())) < 4 and time.monotonic() < deadline:
                time.sleep(0.01)
        finally:
            child.kill()
    assert [event["time_s"] for event in folder.events()] == [0.0, 1.0, 2.0, 3.0]


def test_a_line_that_cannot_be_synced_is_told_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fsync(_: object) -> None:
        raise OSError(EIO, os.strerror(EIO))

    with create(tmp_path) as run:
        monkeypatch.setattr("os.fsync", fsync)
        run.take(noted("tick", ""))
        with pytest.raises(RecordError, match=r"events\.jsonl: Input/output error"):
            run.flush()
        monkeypatch.undo()
        run.take(noted("tock", ""))
        run.flush()
        assert run.lost_lines == 1


def test_a_last_line_cut_short_is_left_out_and_a_damaged_middle_is_an_error(tmp_path: Path) -> None:
    with create(tmp_path) as run:
        record_all(run)
    events = run.folder.path / "events.jsonl"
    whole = events.read_bytes()
    for cut in range(len(whole.splitlines()[0]) + 2, len(whole)):
        events.write_bytes(whole[:cut])
        assert [event["kind"] for event in run.folder.events()] == ["connect"]
    events.write_bytes(b"{oops}\n" + whole)
    with pytest.raises(RecordError, match="line 1 is damaged"):
        list(run.folder.events())


def test_a_run_in_which_nothing_happened_is_removed(tmp_path: Path) -> None:
    with create(tmp_path) as run:
        assert run.is_empty
        run.folder.rrd_path.write_bytes(b"RRF2")
        run.discard()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_a_person_made_is_kept_empty(tmp_path: Path) -> None:
    out = tmp_path / "mine"
    out.mkdir()
    with create(tmp_path, out=out) as run:
        run.discard()
    assert list(out.iterdir()) == []
    with create(tmp_path, out=tmp_path / "new") as run:
        run.discard()
    assert not (tmp_path / "new").exists()


def test_a_run_that_was_to_go_on_and_did_not_is_as_it_was(tmp_path: Path) -> None:
    with create(tmp_path) as run:
        record_all(run)
        run.finish("interrupted", {"distance_m": 12.0})
    before = {file.name: file.read_bytes() for file in run.folder.path.iterdir()}
    with RunRecorder.resume(run.folder, MISSION) as again:
        assert run.folder.summary()["outcome"] == "in flight"
        assert again.is_empty
        again.discard()
    assert {file.name: file.read_bytes() for file in run.folder.path.iterdir()} == before
    assert run.folder.damaged_files() == []


def test_what_is_not_the_runs_is_kept(tmp_path: Path) -> None:
    with create(tmp_path) as run:
        (run.folder.path / "truth.jsonl").touch()
        (run.folder.path / "notes.txt").write_text("mine")
        run.discard()
    assert [file.name for file in run.folder.path.iterdir()] == ["notes.txt"]


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="no run folder"):
        RunFolder.open(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_summary_that_is_cut_short_is_a_clear_error(tmp_path: Path) -> None:
    with create(tmp_path) as run:
        file = run.folder.path / "summary.json"
        assert json.loads(file.read_text())["outcome"] == "in flight"
        file.write_text('{"outcome": ')
    with pytest.raises(RecordError, match=r"summary\.json is damaged"):
        run.folder.summary()


def test_the_mission_as_flown_can_be_flown_again(tmp_path: Path):
    mission = MISSION.model_copy(update={"name": "2e2"})  # a text, if it looks like a number
    with RunRecorder.create(mission, root=tmp_path) as run:
        assert load_mission(run.folder.path / MISSION_FILE).mission == mission
        run.finish("completed", {})
