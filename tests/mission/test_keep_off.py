"""What a mission may ask to be kept off."""

from __future__ import annotations

from pathlib import Path

import pytest

from dronemon.errors import MissionFileError
from dronemon.mission import Mission, load_mission

TEXT = """
area: {area}
flight: {flight}
targets:
  - {{name: Zuri, appearance: zebra, count: 3, keep_off: {keep_off}}}
  - {{name: Rusty, appearance: fox}}
"""
SQUARE = "{side_m: 200}"
SLOW = "{altitude_m: 45, cruise_speed_m_s: 5, horizon_au: 5}"


def load(tmp_path: Path, keep_off: str, *, flight: str = SLOW, area: str = SQUARE) -> Mission:
    path = tmp_path / "mission.yaml"
    path.write_text(TEXT.format(area=area, flight=flight, keep_off=keep_off))
    return load_mission(path).mission


@pytest.mark.parametrize(("below_m", "kept_off_m"), [(60, {0: 10, 1: 10, 2: 10}), (45, {})])
def test_every_one_of_an_entry_is_kept_off_below_its_height(tmp_path, below_m, kept_off_m):
    mission = load(tmp_path, f"{{distance_m: 10, below_m: {below_m}}}")
    assert mission.kept_off_m == kept_off_m


@pytest.mark.parametrize(
    ("keep_off", "flight", "words"),
    [
        ("{distance_m: 13, below_m: 60}", SLOW, "keep 12.4 m or less off, fly slower"),
        ("{distance_m: 10, below_m: 60}", SLOW.replace(": 5,", ": 9,"), "keep 5.3 m or less"),
        ("{distance_m: 1, below_m: 60}", SLOW.replace(": 5,", ": 15,"), "; fly slower"),
    ],
)
def test_what_could_never_be_seen_is_refused_once_with_what_would_do(
    tmp_path, keep_off, flight, words
):
    with pytest.raises(MissionFileError, match=r"keep_off\.distance_m") as refused:
        load(tmp_path, keep_off, flight=flight)
    assert words in str(refused.value)
    assert "area.side_m larger" in str(refused.value)
    assert str(refused.value).count("keep_off") == 1


def test_from_above_it_may_be_as_wide_as_one_likes(tmp_path):
    assert load(tmp_path, "{distance_m: 100, below_m: 40}").kept_off_m == {}


def test_of_a_field_the_sensor_radius_is_to_grow(tmp_path):
    area = "{sensor_radius_m: 10, polygon_m: [[0, 0], [200, 0], [200, 200], [0, 200]]}"
    with pytest.raises(MissionFileError, match=r"area\.sensor_radius_m larger"):
        load(tmp_path, "{distance_m: 9, below_m: 60}", area=area)


@pytest.mark.parametrize(
    ("keep_off", "words"),
    [
        ("{distance_m: 10}", "below_m: is missing"),
        ("{distance_m: 10, below: 60}", "did you mean `below_m`"),
        ("{distance_m: 0, below_m: 60}", "greater than or equal to 1"),
        ("20", "keep_off: "),
    ],
)
def test_what_is_wrong_is_told_by_its_key(tmp_path, keep_off, words):
    with pytest.raises(MissionFileError) as refused:
        load(tmp_path, keep_off)
    assert words in str(refused.value)
