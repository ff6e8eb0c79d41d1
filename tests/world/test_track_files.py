"""Files of tracks: what they become, and what is said of those that cannot be used."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from dronemon.errors import MissionFileError, OptionError
from dronemon.feasibility import load_checked
from dronemon.world import Instance
from dronemon.world.tracks import draw_tracks

names = itertools.count()


def written(folder: Path, text: str, suffix: str = ".csv") -> Path:
    path = folder / f"tracks{next(names)}{suffix}"
    path.write_text(text, encoding="utf-8")
    return path


AU = """time,target,x,y
0,cow,0.1,0.1
10,cow,0.3,0.1
20,cow,0.3,0.3
30,cow,0.3,0.3
5,goat,0.9,0.5
15,goat,0.9,0.6
30,goat,0.9,0.9
"""


def test_targets_walk_as_in_the_file_over_the_time_they_share_and_back(tmp_path: Path) -> None:
    paths = draw_tracks(written(tmp_path, AU), 2)
    walked = (0.3 + 0.4) / 2.0  # in the mean, between the instants 5 and 30
    at = walked * (np.array([5.0, 10.0, 17.5, 30.0, 55.0]) - 5.0) / 25.0
    cow, goat = paths.positions_au(at).transpose(1, 0, 2)
    np.testing.assert_allclose(cow, [[0.2, 0.1], [0.3, 0.1], [0.3, 0.25], [0.3, 0.3], [0.2, 0.1]])
    np.testing.assert_allclose(goat[:, 1], [0.5, 0.55, 0.65, 0.9, 0.5])
    alone = Instance.draw(3, 1, str(written(tmp_path, AU))).paths  # from 0 to 30, by its own speed
    np.testing.assert_allclose(alone.positions_au([0.0, 0.4 / 3.0])[:, 0], [[0.1, 0.1], [0.3, 0.1]])


MOVEBANK = """event-id,timestamp,location-long,location-lat,individual-local-identifier
1,2020-05-01 12:00:00.000,179.99,-1.00,A
2,2020-05-01 13:00:00.000,-179.99,-1.00,A
3,2020-05-01 12:00:00.000,179.99,-1.01,B
4,2020-05-01 13:00:00.000,179.99,-0.99,B
"""
GPX = """<?xml version="1.0"?>
<gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1">
 <metadata><name>both</name></metadata>
 <trk><name>A</name><trkseg>
  <trkpt lat="-1.00" lon="179.99"><ele>3</ele><time>2020-05-01T12:00:00Z</time></trkpt>
  <trkpt lat="-1.00" lon="-179.99"><time>2020-05-01T13:00:00Z</time></trkpt>
 </trkseg></trk>
 <trk><trkseg>
  <trkpt lat="-1.01" lon="179.99"><time>2020-05-01T12:00:00Z</time></trkpt>
  <trkpt lat="-0.99" lon="179.99"><time>2020-05-01T13:00:00Z</time></trkpt>
 </trkseg></trk>
</gpx>
"""


def test_places_on_the_globe_fill_the_square_without_being_stretched(tmp_path: Path) -> None:
    ends = []
    for path in (written(tmp_path, MOVEBANK), written(tmp_path, GPX, ".gpx")):
        paths = draw_tracks(path, 2)
        ends.append(paths.positions_au(np.array([0.0, paths.lengths_au[0]])))
    np.testing.assert_allclose(ends[0], ends[1])
    (a_from, b_from), (a_to, b_to) = ends[0]
    # East is x, north is y; a minute of longitude at the equator is 0.66 % longer than of latitude.
    np.testing.assert_allclose([a_from, a_to], [[0.0, 0.5], [1.0, 0.5]], atol=0.002)
    np.testing.assert_allclose([b_from, b_to], [[0.0, 0.0033], [0.0, 0.9967]], atol=0.002)


def test_tracks_of_one_name_are_two_targets_and_animals_go_before_tags(tmp_path: Path) -> None:
    twins = GPX.replace("<trk><trkseg>", "<trk><name>A</name><trkseg>")
    assert draw_tracks(written(tmp_path, twins, ".gpx"), 2).num_targets == 2
    tags = MOVEBANK.replace("event-id", "tag-local-identifier")
    assert draw_tracks(written(tmp_path, tags), 2).num_targets == 2


def au(*lines: str) -> str:
    return "\n".join(["time,target,x,y", *lines])


GLOBE = "time,target,lat,lon\n"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "line 1: no column time"),
        (au(), "has no fixes"),
        ("time,x,y\n0,0.1,0.1\n", "line 1: no column target"),
        (au("0,cow,0.1,0.1"), "line 2: the only fix of cow"),
        (au("0,cow,0.1,0.1", "2,cow,0.2,0.1", "1,cow,0.3,0.1"), "line 4: not later than"),
        (au("0,cow,0.1,0.1", "0,cow,0.2,0.1"), "line 3: not later than"),
        (
            au(*(f"{t},cow,{t / 100},0.1" for t in (0, 1, 2, 3, 30, 31))),
            "line 6: no fix of cow for 27 since line 5, where they come every 1",
        ),
        (
            au("0,cow,0.1,0.1", "1,cow,350,120"),
            "line 3: cow at 350, 120 is not in the area",
        ),
        (au("0,cow,0.1,0.1", "1,cow,,0.1"), "line 3: '' is no number"),
        (au("0,cow,0.1,0.1", "1,cow,nan,0.1"), "line 3: 'nan' is no number"),
        (au("0,cow,0.1,0.1", "noon,cow,0.1,0.1"), "line 3: 'noon' is no time"),
        (au("0,cow,0.1,0.1", "inf,cow,0.1,0.1"), "line 3: time 'inf' is not less than"),
        (au("0,cow,0.1,0.1", "1,cow,0.1"), "line 3: has 3 cells"),
        (au("0,,0.1,0.1"), "line 2: the target's name has 0 letters"),
        (au("0,cow,0.1,0.1", "1,cow,0.1,0.1"), "its 1 targets walk 0 au"),
        (au("0,cow,0.1,0.1", "1e300,cow,0.9,0.1"), "line 3: time '1e300' is not less than 1e+15"),
        (au("0," + "x" * 101 + ",0.1,0.1"), "line 2: the target's name has 101 letters"),
        ("x" * 200_000 + "\n", "line 1: field larger than field limit"),
        (
            au("0,cow,0.1,0.1", "1,cow,0.2,0.1", "1,goat,0.1,0.1", "2,goat,0.2,0.1"),
            "no time at which all 2 targets",
        ),
        (GLOBE + "0,cow,47.1,8.1\n1,cow,95,8.1\n", "line 3: 95, 8.1 is no latitude"),
        (GLOBE + "0,cow,47.1,8.1\n1,cow,47.1,8.1\n", "stay within a metre"),
    ],
)
def test_a_file_of_no_use_is_told_by_its_line(tmp_path: Path, text: str, told: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(OptionError) as raised:
        draw_tracks(path, 2 if "goat" in text else 1)
    assert str(raised.value).startswith(f"{path}")
    assert told in str(raised.value)


def test_bad_gpx_and_files_that_cannot_be_read_are_told(tmp_path: Path) -> None:
    cases = {
        GPX.replace("</trkseg></trk>\n</gpx>", ""): "is no GPX",
        GPX.replace('lon="179.99"', ""): "line 5: '' is no number",
        '<!DOCTYPE g [<!ENTITY a "b">]>' + GPX: "declares entities",
        GPX.replace('"1.0"?', '"1.0" encoding="foo"?'): "is no GPX",
        GPX.replace("<time>2020-05-01T13:00:00Z</time>", "", 1): "line 6: '' is no time",
    }
    for text, told in cases.items():
        with pytest.raises(OptionError, match=told):
            draw_tracks(written(tmp_path, text, ".gpx"), 2)
    with pytest.raises(OptionError, match="cannot be read: No such file"):
        draw_tracks(tmp_path / "none.csv", 1)
    latin = tmp_path / "latin.csv"
    latin.write_bytes("time,target,x,y\n0,Kühe,0.1,0.1\n".encode("latin-1"))
    with pytest.raises(OptionError, match="no text in UTF-8"):
        draw_tracks(latin, 1)


def test_a_mission_finds_its_tracks_beside_it_and_needs_one_for_each_target(tmp_path: Path) -> None:
    tracks = written(tmp_path, AU)
    mission = tmp_path / "mission.yaml"
    target = {"appearance": "cow", "prior_au": "simulated"}
    for count in (2, 3):
        targets = [
            {**target, "name": f"t{i}", "appearance": a}
            for i, a in enumerate(("cow", "zebra", "fox")[:count])
        ]
        told = {"simulation": {"motion": tracks.name}, "targets": targets}
        mission.write_text(json.dumps(told))
        if count == 2:
            assert load_checked(str(mission), {}, None).mission.simulation.motion == str(tracks)
        else:
            with pytest.raises(MissionFileError, match="has 2 targets; 3 are wanted"):
                load_checked(str(mission), {}, None)


def test_a_motion_that_there_is_not_is_told_with_those_that_there_are(tmp_path: Path) -> None:
    mission = tmp_path / "mission.yaml"
    cases = {"circles": "'circles' is none of tsp, way", "no.csv": "no.csv: cannot be read"}
    target = {"name": "a", "appearance": "cow"}
    for motion, told in cases.items():
        mission.write_text(json.dumps({"simulation": {"motion": motion}, "targets": [target]}))
        with pytest.raises(MissionFileError, match=f"mission.yaml:1: simulation.motion: .*{told}"):
            load_checked(str(mission), {}, None)
