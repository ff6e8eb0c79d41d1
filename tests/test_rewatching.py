"""Pictures of an earlier flight are seen and believed as in a flight, and its folder is a run's."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from PIL import Image
from recorded_flight import (
    BEGAN,
    CENTRE,
    MISSION,
    PLACES_M,
    Shot,
    away_m,
    lanes,
    save_tagged,
    save_with_table,
    write_table,
)

from dronemon.camera import read_posed
from dronemon.detecting import detect_command
from dronemon.errors import CameraError, DronemonError, OptionError, RecordError
from dronemon.export.command import export_command
from dronemon.export.finds import Finds
from dronemon.export.story import read_story
from dronemon.mission import load_mission
from dronemon.recorder import RunFolder
from dronemon.report.command import report_command
from dronemon.rewatching import rewatch_command
from dronemon.runner.history import read_newest
from dronemon.runner.status import ask_to_go_on, status
from dronemon.types import Detection, Pose

LOOKS = {"Bella": "cow", "Zuri": "zebra", "Rusty": "fox", "Pan": "panda"}
NEAR_M, SEES_M = 0.5, 20.0


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("mission") / "m.yaml"
    path.write_text(MISSION)
    return str(path)


@pytest.fixture(scope="module")
def tilted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """From a fixed camera on a vehicle that leans and turns."""
    folder = tmp_path_factory.mktemp("tilted")
    save_with_table(folder, lanes([(0, 0, 0), (6, -5, 3), (-7, 5, -170), (3, 8, 90)])[::2])
    return folder


@pytest.fixture(scope="module")
def tagged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """From a gimbal: straight down, forwards, beyond, and rolled."""
    folder = tmp_path_factory.mktemp("tagged")
    angles = [(0, -90, 0), (0, -78, 12), (180, -89.5, 100), (25, -90, -60), (4, -84, 200)]
    save_tagged(folder, lanes(angles)[::2])
    return folder


def rewatch(folder: Path, mission: str, out: Path, **options: Any) -> int:
    with pytest.raises(typer.Exit) as caught:
        rewatch_command(folder, mission, out=out, **options)
    return caught.value.exit_code


@pytest.fixture(scope="module")
def run(
    tilted: Path, tagged: Path, mission: str, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    """The runs that both come to."""
    root = tmp_path_factory.mktemp("runs")
    for name, folder in (("tilted", tilted), ("tagged", tagged)):
        assert rewatch(folder, mission, root / name) == 0
    return {name: root / name for name in ("tilted", "tagged")}


def sightings(run: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    for line in RunFolder.open(run).observations():
        yield from ((name, told) for name, told in line["targets"].items() if told["seen"])


@pytest.mark.lengthy
@pytest.mark.parametrize("name", ["tilted", "tagged"])
def test_animals_are_seen_where_they_are(run: dict[str, Path], name: str) -> None:
    """In body tilt, and with a gimbal in every attitude: to half a metre from 35 m."""
    shots, seen = lanes([(0, 0, 0)])[::2], list(sightings(run[name]))
    for who, told in seen:
        assert away_m(told["place"], PLACES_M[LOOKS[who]]) < NEAR_M
    for who, look in LOOKS.items():
        near = [s for s in shots if math.dist(s.place_m, PLACES_M.get(look, (1e3, 0))) < SEES_M]
        assert sum(n == who for n, _ in seen) >= 0.7 * len(near)
    assert {who for who, _ in seen} == {"Bella", "Zuri", "Rusty"}


@pytest.mark.lengthy
def test_it_leaves_what_a_flight_leaves(run: dict[str, Path], tmp_path: Path) -> None:
    """Report, map and table are made of it, by the times at which the pictures were taken."""
    folder = RunFolder.open(run["tagged"])
    assert folder.damaged_files() == []
    assert folder.recordings() == ["flight.rrd"]
    summary = folder.summary()
    assert (summary["outcome"], summary["pictures"], summary["num_blind"]) == ("rewatched", 9, 0)
    assert summary["rewatched"].endswith("tagged0")
    began = BEGAN - timedelta(hours=2)
    assert read_story(folder).started.replace(tzinfo=None) == began.replace(microsecond=0)
    report_command(run["tagged"], tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "Nothing was flown: these are pictures of an earlier flight." in page
    assert "fly it again" not in page
    assert 'class="bad"' not in page
    export_command(run["tagged"], tmp_path / "map")
    rows = list(csv.DictReader((tmp_path / "map" / "sightings.csv").read_text().splitlines()))
    assert len(rows) == len(list(sightings(run["tagged"])))
    times = {datetime.fromisoformat(row["time"]).replace(tzinfo=None) for row in rows}
    assert times <= {began + timedelta(seconds=1.5 * number) for number in range(18)}
    assert all((tmp_path / "map" / row["picture"]).is_file() for row in rows)
    assert "from pictures of an earlier flight" in (tmp_path / "map" / "track.gpx").read_text()
    assert status(folder, folder.mission())["program"] == "ended: rewatched"


@pytest.mark.lengthy
def test_nobody_can_fly_on_from_pictures(run: dict[str, Path]) -> None:
    folder = RunFolder.open(run["tilted"])
    for go_on in (read_newest, ask_to_go_on):
        with pytest.raises(RecordError, match="made of pictures: it was not flown"):
            go_on(folder)


def test_what_was_known_and_seen_is_told_in_the_end(
    tilted: Path, mission: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rewatch(tilted, mission, tmp_path / "run", every=4) == 0
    out, err = capsys.readouterr()
    told = " ".join(re.sub("[│┃]", " ", out).split())
    assert "prior_au is simulated, and so unknown here, of Rusty" in err
    assert "Pan never seen in 24 s" in told
    assert re.search(r"Bella seen .* at -33\.9178\d+, 18\.4229\d+", told)
    assert "pictures 3 of 3" in told
    assert "time of detector" in told
    assert "battery" not in told
    began = next(e for e in RunFolder.open(tmp_path / "run").events() if e["kind"] == "patrol")
    assert began["priors_au"] == [[0.5, 0.6], *[[None, None]] * 3]


def save_odd(folder: Path) -> None:
    """Two that say something, and between them one of each kind that does not."""
    odd = {"tilted": (0, 50, 0), "low": (0, 0, 0), "dark": (0, 0, 0), "frozen": (0, 0, 0)}
    shots = [
        Shot(
            name=f"{number}-{name}.jpg",
            time_s=2.0 * number,
            place_m=(4.0 * number, 0.0),
            angles_deg=odd.get(name, (0, 0, 0)),
            height_m=5.0 if name == "low" else 35.0,
        )
        for number, name in enumerate(["good", *odd, "better"])
    ]
    save_with_table(folder, shots)
    _, _, low, dark, frozen, _ = (folder / shot.name for shot in shots)
    Image.new("RGB", (640, 480)).save(dark)
    frozen.write_bytes(low.read_bytes())


def test_pictures_that_say_nothing_are_counted_and_told(
    mission: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_odd(tmp_path / "odd")
    assert rewatch(tmp_path / "odd", mission, tmp_path / "run") == 0
    folder = RunFolder.open(tmp_path / "run")
    assert (folder.summary()["pictures"], folder.summary()["num_blind"]) == (2, 4)
    assert [line["time_s"] for line in folder.observations()] == [0.0, 10.0]
    first, last = (e["text"] for e in folder.events() if e["kind"] == "camera")
    assert re.match(
        r"1-tilted\.jpg says nothing: shows 0 m of ground to all sides .* 10 m are", first
    )
    assert last == "5-better.jpg says something again, after 4 that did not"
    assert "said nothing" in capsys.readouterr().out


def test_heights_above_the_sea_are_not_believed(mission: str, tmp_path: Path) -> None:
    """Nothing is found from so high, which would count as nobody there."""
    save_with_table(tmp_path / "high", lanes([(0.0, 0.0, 0.0)])[:3])
    table = tmp_path / "high" / "poses.csv"
    rows = list(csv.DictReader(table.read_text().splitlines()))
    with table.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows({**row, "altitude_m": 1500.0 + float(row["altitude_m"])} for row in rows)
    with pytest.raises(CameraError, match=r"from 1535 m, .* above the sea instead"):
        rewatch_command(tmp_path / "high", mission, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (1, "shows 0 m of ground to all sides of the drone, and 10 m are needed"),
        (2, "shows 4 m of ground to all sides of the drone, and 10 m are needed"),
        (3, "shows nothing at all"),
    ],
)
def test_where_no_picture_says_anything_it_fails(
    mission: str, tmp_path: Path, number: int, words: str
) -> None:
    save_odd(tmp_path / "odd")
    files = sorted((tmp_path / "odd").glob("*.jpg"))
    rows = list(csv.reader((tmp_path / "odd" / "poses.csv").read_text().splitlines()))[1:]
    for file in files:
        if not file.name.startswith(str(number)):
            file.unlink()
    write_table(tmp_path / "odd", [rows[number]])
    with pytest.raises(CameraError, match="none of its 1 pictures says anything"):
        rewatch_command(tmp_path / "odd", mission, out=tmp_path / "run")
    folder = RunFolder.open(tmp_path / "run")
    assert folder.summary()["outcome"] == "failed"
    told = next(e["text"] for e in folder.events() if e["kind"] == "camera")
    assert re.search(words, told)


def test_nothing_is_written_where_anything_is_wrong(
    tilted: Path, mission: str, tmp_path: Path
) -> None:
    """The area is elsewhere, a table is wrong, a picture has another size, --home is no place."""
    out, elsewhere, small = (tmp_path / name for name in ("run", "far.yaml", "small.yaml"))
    elsewhere.write_text(MISSION.replace("latitude_deg: -33.918", "latitude_deg: -34.918"))
    small.write_text(MISSION + "camera: {width_px: 320, height_px: 240}\n")
    (tmp_path / "bad.csv").write_text("picture\n")
    wrong: list[tuple[str, dict[str, Any], str]] = [
        (str(elsewhere), {}, r"no picture shows the mission's area, the nearest is 1108\d\d m off"),
        (str(small), {}, r"DJI_0000\.JPG: .* 640 x 480 pixels, the mission says 320 x 240"),
        (mission, {"poses": tmp_path / "bad.csv"}, r"bad\.csv:1: has no column time_s"),
        (mission, {"home": "91,0"}, "--home 91,0: .* swapped"),
        (mission, {"home": "here"}, "--home here: .* give LAT,LON in degrees"),
    ]
    for name, options, words in wrong:
        with pytest.raises(DronemonError, match=words):
            rewatch_command(tilted, name, out=out, **options)
        assert not out.exists()


def test_an_area_around_home_lies_around_the_first_picture_or_where_it_is_said(
    tilted: Path, tmp_path: Path
) -> None:
    around = tmp_path / "around.yaml"
    around.write_text(re.sub(r", latitude_deg.*}", "}", MISSION))
    at = f"{CENTRE[0]}, {CENTRE[1]}"
    for name, home, centre_m in (("first", None, (-24.0, 0.0)), ("said", at, (0.0, 0.0))):
        assert rewatch(tilted, str(around), tmp_path / name, home=home, every=9) == 0
        story = read_story(RunFolder.open(tmp_path / name))
        corners = [(c.latitude_deg, c.longitude_deg) for c in story.corners[:-1]]
        latitude, longitude = np.mean(corners, axis=0).tolist()
        place = {"latitude_deg": latitude, "longitude_deg": longitude}
        assert away_m(place, centre_m) < 0.1


def test_ctrl_c_leaves_what_was_seen_so_far(
    tilted: Path, mission: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dronemon.runner.eyes import Eyes

    look, looks = Eyes.look, list[object]()

    def interrupted(*given: Any) -> Any:
        looks.append(given)
        if len(looks) == 3:
            raise KeyboardInterrupt
        return look(*given)

    monkeypatch.setattr(Eyes, "look", interrupted)
    assert rewatch(tilted, mission, tmp_path / "run") == 130
    summary = RunFolder.open(tmp_path / "run").summary()
    assert (summary["outcome"], summary["pictures"]) == ("interrupted", 2)


def test_detect_says_where_finds_are(tagged: Path, mission: str, tmp_path: Path) -> None:
    detect_command(str(tagged), mission, tmp_path / "out")
    rows = list(csv.DictReader((tmp_path / "out" / "detections.csv").read_text().splitlines()))
    near = [row for row in rows if row["appearance"] in PLACES_M]
    assert len(near) > 10
    off_m = []
    for row in near:
        place = {name: float(row[name]) for name in ("latitude_deg", "longitude_deg")}
        off_m.append(away_m(place, PLACES_M[row["appearance"]]))
        north_m, east_m = PLACES_M[row["appearance"]]  # from below the first picture, 24 m south
        assert math.dist(
            (float(row["north_m"]) - 24.0, float(row["east_m"])), (north_m, east_m)
        ) < (off_m[-1] + 0.1)
    assert np.quantile(off_m, 0.9) < 1.0
    told = json.loads((tmp_path / "out" / "detections.geojson").read_text())["features"]
    kinds = [feature["properties"]["kind"] for feature in told]
    assert kinds == ["track", *["sighting"] * len(rows)]
    first = told[1]
    assert first["properties"]["class"] == rows[0]["appearance"]
    assert (tmp_path / "out" / first["properties"]["picture"]).is_file()
    degrees = [float(rows[0][name]) for name in ("longitude_deg", "latitude_deg")]
    assert first["geometry"]["coordinates"] == pytest.approx(degrees)


def test_detect_without_poses_is_as_before(tilted: Path, mission: str, tmp_path: Path) -> None:
    """None are looked for where a height is given, and none are there beside a single picture."""
    detect_command(str(tilted / "DJI_0000.JPG"), mission, tmp_path / "one")
    detect_command(str(tilted), mission, tmp_path / "all", height_m=35.0, every=9)
    for name in ("one", "all"):
        head = (tmp_path / name / "detections.csv").read_text().splitlines()[0]
        assert head.endswith(",bottom_px")
        assert not (tmp_path / name / "detections.geojson").exists()
    with pytest.raises(OptionError, match="--height-m: is what --poses tells"):
        detect_command(str(tilted), mission, height_m=35.0, poses=tilted / "poses.csv")


def test_detect_tells_why_it_does_not_say_where_finds_are(
    tagged: Path, mission: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of pictures of two flights, which are looked at all the same."""
    later = Shot(name="later.jpg", time_s=900.0, place_m=(0.0, 0.0), angles_deg=(0, -90, 0))
    folder = tmp_path / "pictures"
    shutil.copytree(tagged, folder)
    save_tagged(folder, [later])
    detect_command(str(folder), mission, tmp_path / "two")
    assert "later.jpg is 876 s later than DJI_0016.JPG" in capsys.readouterr().err.replace("\n", "")
    assert not (tmp_path / "two" / "detections.geojson").exists()


@pytest.mark.parametrize(
    ("height_m", "pitch_rad", "is_placed"),
    [(35.0, 0.0, True), (0.0, 0.0, False), (35.0, 1.6, False)],
)
def test_a_find_is_nowhere_where_no_ground_is_seen(
    tilted: Path, mission: str, height_m: float, pitch_rad: float, is_placed: bool
) -> None:
    of = load_mission(Path(mission)).mission
    pose = replace(Pose.level(height_m), attitude_rad=(0.0, pitch_rad, 0.0))
    finds = Finds(of, read_posed(tilted, None, of.camera))
    found = Detection(appearance="cow", pixel_px=(320.0, 100.0), score=0.9)
    (row,) = finds.add([found], pose, Path("marked.jpg"))
    assert [bool(text) for text in row] == [is_placed] * len(Finds.columns)
    assert (b'"cow"' in finds.geojson()) == is_placed


def test_a_camera_that_is_mounted_aslant_is_rectified_first(tmp_path: Path) -> None:
    """The table has the vehicle's angles; the mission how the camera sits on it."""
    mount_deg, path = (4.0, -7.0, 90.0), tmp_path / "mounted.yaml"
    path.write_text(f"{MISSION}camera: {{mount_deg: {list(mount_deg)}}}\n")
    shots = lanes([(0, 0, 0), (5, -4, 30)])[2:15:3]
    save_with_table(tmp_path / "pictures", shots, mount_deg)
    assert rewatch(tmp_path / "pictures", str(path), tmp_path / "run") == 0
    seen = list(sightings(tmp_path / "run"))
    assert {who for who, _ in seen} == {"Bella", "Zuri", "Rusty"}
    for who, told in seen:
        assert away_m(told["place"], PLACES_M[LOOKS[who]]) < NEAR_M
