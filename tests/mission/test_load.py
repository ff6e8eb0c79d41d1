"""Every mistake in a mission file gives one message with file, line, key and the next step."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dronemon.errors import MissionFileError
from dronemon.mission import Mission, find_mission, load_mission, shipped_missions

ROOT = Path(__file__).parents[2]
ANIMALS = (ROOT / "missions" / "animals.yaml").read_text().split("\n", 1)[1]


def _error(tmp_path: Path, text: str) -> str:
    path = tmp_path / "m.yaml"
    path.write_text(text)
    with pytest.raises(MissionFileError) as caught:
        load_mission(path)
    return str(caught.value).removeprefix(str(path))


def test_animals_is_the_papers_experiment():
    mission = load_mission(find_mission("animals")).mission
    assert mission.area.side_m == 200
    assert mission.horizon_au == 30
    assert len({t.appearance for t in mission.targets}) == 3


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("altitude_m: 35", "altitude_m: 10", 6, ["flight.altitude_m", "too low", "26.7 m"]),
        ("altitude_m:", "altitud:", 6, ["flight.altitud", "did you mean `altitude_m`"]),
        ("altitude_m:", "altitude_ft:", 6, ["flight.altitude_ft", "did you mean `altitude_m`"]),
        ("altitude_m: 35", "altitude_m: 35 m", 6, ["valid number", "'35 m'", "unit"]),
        ("horizon_au: 30", "horizon_au: true", 8, ["flight.horizon_au", "valid number", "True"]),
        ("appearance: fox", "apearance: fox", 12, ["did you mean `appearance`"]),
        ("horizon_au: 30", "return_battery: 0.02", 5, ["horizon_au", "way back", "return_battery"]),
        ("side_m: 200", "side_m: -3", 4, ["area.side_m", "greater than or equal to 10", "-3"]),
        ("horizon_au: 30", "horizon_au: 60", 8, ["flight.horizon_au", "battery", "22.5 min"]),
        ("horizon_au: 30", "horizon_au: .nan", 8, ["flight.horizon_au", "finite"]),
        ("appearance: fox", "appearance: cow", 12, ["targets[2].appearance", "target 1"]),
        ("appearance: fox", "appearance: dog", 12, ["targets[2].appearance", "'panda'", "'dog'"]),
        ("name: Bella", "name: Zuri", 11, ["targets[1].name", "target 1"]),
        ("{name: Bella, ", "{", 10, ["targets[0].name", "is missing"]),
        ("name: animals", "nome: animals", 2, ["nome", "did you mean `name`"]),
        ("seed: 0", "seed: 0\n  seed: 1", 17, ["seed", "given twice"]),
        ("prior_au: simulated", "prior_au: [2, 3]", 10, ["targets[0].prior_au"]),
        ("side_m: 200", "latitude_deg: 3", 3, ["area", "longitude_deg"]),
        ("horizon_au: 30", "horizon_au: 30\n  horizon_min: 3", 5, ["flight", "not both"]),
        ("targets:", "targets: [", 10, ["not valid YAML"]),
        ("simulation:", "vehicle:\n  url: 14540\nsimulation:", 16, ["vehicle.url"]),
        ("simulation:", "vehicle: {url: 'udp:1'}\nsimulation:", 15, ["vehicle", "udpin://"]),
    ],
)
def test_message_names_line_and_key(
    tmp_path: Path, old: str, new: str, line: int, words: list[str]
):
    message = _error(tmp_path, ANIMALS.replace(old, new, 1))
    assert message.startswith(f":{line}: "), message
    for word in words:
        assert word in message


@pytest.mark.parametrize("text", ["", "3", "- a\n- b", "just words"])
def test_a_file_that_is_no_mapping(tmp_path: Path, text: str):
    assert "mapping of sections" in _error(tmp_path, text)


def test_a_file_that_is_no_text(tmp_path: Path):
    path = tmp_path / "m.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MissionFileError, match="cannot be read"):
        load_mission(path)


def test_yaml_cannot_make_objects(tmp_path: Path):
    message = _error(tmp_path, "name: !!python/object/apply:os.system ['true']\n")
    assert "not valid YAML" in message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: &a [*a]", "aliases are not allowed"),
        ("a: &a [1]\nb: &b [*a, *a]", "aliases are not allowed"),
        ("[" * 2000 + "]" * 2000, "nested too deeply"),
    ],
)
def test_hostile_yaml(tmp_path: Path, text: str, words: str):
    assert words in _error(tmp_path, text)


def test_missing_files_and_names(tmp_path: Path):
    with pytest.raises(MissionFileError, match=r"no such mission file; .*animals"):
        find_mission(str(tmp_path / "none.yaml"))
    with pytest.raises(MissionFileError, match=r"no shipped mission has this name; .*animals"):
        find_mission("animal")
    assert find_mission("animals") == shipped_missions()["animals"]


def test_command_line_overrides_the_file(tmp_path: Path):
    path = tmp_path / "m.yaml"
    path.write_text(ANIMALS)
    loaded = load_mission(
        path,
        {
            ("vehicle", "speed_up"): ("--speed-up", 20.0),
            ("flight", "horizon_au"): ("--horizon-au", 2.0),
        },
    )
    assert loaded.mission.vehicle.speed_up == 20
    assert loaded.mission.horizon_au == 2
    with pytest.raises(MissionFileError, match=r"^--speed-up: .*less than or equal to 20, but"):
        load_mission(path, {("vehicle", "speed_up"): ("--speed-up", 50.0)})


def test_horizon_in_minutes(tmp_path: Path):
    path = tmp_path / "m.yaml"
    path.write_text(ANIMALS.replace("horizon_au: 30", "horizon_min: 10"))
    assert load_mission(path).mission.horizon_au == pytest.approx(10 * 60 * 5 / 200)
    option = {("flight", "horizon_au"): ("--horizon-au", 3.0)}
    assert load_mission(path, option).mission.horizon_au == 3.0


def test_shipped_schema_is_the_models():
    shipped = json.loads((ROOT / "missions" / "mission.schema.json").read_text())
    assert shipped == Mission.model_json_schema()
