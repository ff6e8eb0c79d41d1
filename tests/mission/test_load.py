"""Every mistake in a mission file gives one message with file, line, key and the next step."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from dronemon.errors import MissionFileError
from dronemon.feasibility import flight_facts, load_checked
from dronemon.mission import Mission, find_mission, load_mission, shipped_missions
from dronemon.mission.addresses import mavlink_url_problem
from dronemon.mission.faults import KINDS
from dronemon.mission.template import mission_template
from dronemon.types import APPEARANCES
from dronemon.vision.view import needed_altitude_m
from sim.world import World

ROOT = Path(__file__).parents[2]
ANIMALS = (ROOT / "missions" / "animals.yaml").read_text().split("\n", 1)[1]
ALTITUDE = next(line.strip() for line in ANIMALS.splitlines() if "altitude_m" in line)


def _error(tmp_path: Path, text: str) -> str:
    path = tmp_path / "m.yaml"
    path.write_text(text)
    with pytest.raises(MissionFileError) as caught:
        load_checked(str(path), {}, None)
    return str(caught.value).removeprefix(str(path))


@pytest.mark.parametrize("name", sorted(shipped_missions()))
def test_every_shipped_mission_can_be_flown(name: str):
    load_checked(name, {}, None)


@pytest.mark.parametrize(
    ("appearance", "altitude_m", "needed"),
    [("car-red", 100, None), ("fox", 50, None), ("fox", 60, "5.5"), ("person-red", 50, "9")],
)
def test_who_is_small_is_looked_at_from_lower(
    tmp_path: Path, appearance: str, altitude_m: float, needed: str | None
):
    path = tmp_path / "m.yaml"
    path.write_text(
        f"area: {{side_m: 100}}\nflight: {{altitude_m: {altitude_m}}}\n"
        f"targets: [{{name: one, appearance: {appearance}}}, {{name: bus, appearance: bus-red}}]\n"
    )
    if needed is None:
        load_checked(str(path), {}, None)
    else:
        with pytest.raises(MissionFileError, match=f"too high: .* detector needs {needed}"):
            load_checked(str(path), {}, None)


def test_animals_is_the_papers_experiment():
    mission = load_mission(find_mission("animals")).mission
    assert mission.area.side_m == 200
    assert mission.horizon_au == 30
    assert len({t.appearance for t in mission.targets}) == 3


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        (ALTITUDE, "altitude_m: 30", 6, ["flight.altitude_m", "too low", "11.5 degrees", "42.3 m"]),
        (ALTITUDE, "altitude_m: 060", 6, ["flight.altitude_m", "`060`", "as 48; write 60 or 48"]),
        (ALTITUDE, "altitude_m: 0x50", 6, ["flight.altitude_m", "read as 80; write 80"]),
        (ALTITUDE, "altitude_m: 0b101101", 6, ["read as 45; write 45"]),
        (ALTITUDE, "altitude_m: 1_00", 6, ["read as 100; write 100"]),
        (ALTITUDE, "altitude_m: 1:30", 6, ["read as 90; write 90"]),
        (ALTITUDE, "altitude_m: 1:30.5", 6, ["read as 90.5; write 90.5"]),
        (ALTITUDE, "altitude_m: .inf", 6, ["flight.altitude_m", "finite"]),
        (ALTITUDE, "start_au: [0.5, 01]", 6, ["flight.start_au[1]", "read as 1; write 1"]),
        ("appearance: fox", "appearance: 0_1", 12, ["targets[2].appearance", "in quotes"]),
        ("name: Rusty", 'name: "Fr\\e[31med"', 12, ["targets[2].name", "'\\x1b'"]),
        ("name: Rusty", 'name: "\\ud83d\\udc04"', 12, ["targets[2].name", "'\\ud83d'"]),
        ("name: Rusty", "name: Fr\x07ed", 12, ["not valid YAML", "'\\x07'"]),
        ("altitude_m:", '"altitude\\n":', 5, ["flight", r"the key 'altitude\n' has the char"]),
        ("altitude_m:", "altitud:", 6, ["flight.altitud", "did you mean `altitude_m`"]),
        ("altitude_m:", "altitude_ft:", 6, ["flight.altitude_ft", "did you mean `altitude_m`"]),
        (ALTITUDE, "altitude_m: 45 m", 6, ["valid number", "'45 m'", "unit"]),
        ("horizon_au: 30", "horizon_au: true", 8, ["flight.horizon_au", "valid number", "True"]),
        ("appearance: fox", "apearance: fox", 12, ["did you mean `appearance`"]),
        ("horizon_au: 30", "return_battery: 0.2", 8, ["did you mean `reserve_battery`"]),
        (
            "side_m: 200",
            "terrain: no.asc",
            4,
            ["area.terrain", "no.asc: cannot be read"],
        ),
        ("horizon_au: 30", "ceiling_m: 44", 6, ["altitude_m", "45 m is above flight.ceiling_m"]),
        (
            "horizon_au: 30",
            "follow_terrain: true",
            8,
            ["flight.follow_terrain", "needs area.terrain"],
        ),
        ("side_m: 200", "side_m: -3", 4, ["area.side_m", "greater than or equal to 10", "-3"]),
        ("horizon_au: 30", "horizon_au: 60", 8, ["flight.horizon_au", "battery", "25.5 min"]),
        ("horizon_au: 30", "horizon_au: .nan", 8, ["flight.horizon_au", "finite"]),
        ("appearance: fox", "appearance: fox, count: 0", 12, ["targets[2].count", "equal to 1"]),
        ("appearance: fox", "appearance: fox, count: 99", 9, ["targets", "are 101"]),
        (
            "appearance: cow, prior_au: simulated",
            "appearance: cow, count: 2, prior_au: [0, 0]",
            10,
            ["targets[0]", "2 of them cannot all be at [0.0, 0.0]"],
        ),
        (
            "simulation:",
            "detector: {confusion: {cat: {cow: 0.1}}}\nsimulation:",
            15,
            ["confusion.cat: no target looks like that"],
        ),
        (
            "simulation:",
            "detector: {confusion: {cow: {fox: 1.0}}}\nsimulation:",
            15,
            ["leaves nothing of cow"],
        ),
        (
            "simulation:",
            "detector: {confusion: {cow: {cow: 0.1}}}\nsimulation:",
            15,
            ["found as itself"],
        ),
        ("appearance: fox", "appearance: fix", 12, ["targets[2].appearance", "'fix'", "mean fox"]),
        ("simulation:", "detector: {tile_px: 640}\nsimulation:", 15, ["tile_px: is for kind onnx"]),
        ("simulation:", "detector: {kind: onnx}\nsimulation:", 15, ["detector.file: is missing"]),
        ("simulation:", "detector: {classes: [a, a]}\nsimulation:", 15, ["has a class twice"]),
        ("simulation:", "detector: {size_m: [3, 1]}\nsimulation:", 15, ["the least comes first"]),
        (
            "simulation:",
            "detector: {kind: blobs}\nsimulation:",
            15,
            ["all targets have the same app"],
        ),
        ("simulation:", "detector: {hue_deg: [0, 360]}\nsimulation:", 15, ["one hue alone"]),
        ("simulation:", "detector: {kind: blobs}\nsimulation:", 15, ["anything is a blob"]),
        ("simulation:", "detector: {layout: yolo}\nsimulation:", 15, ["detector.layout", "rtdetr"]),
        ("name: Bella", "name: Zuri", 11, ["targets[1].name", "target 1"]),
        ("{name: Bella, ", "{", 10, ["targets[0].name", "is missing"]),
        ("name: animals", "nome: animals", 2, ["nome", "did you mean `name`"]),
        ("seed: 0", "seed: 0\n  seed: 1", 17, ["seed", "given twice"]),
        ("prior_au: simulated", "prior_au: [2, 3]", 10, ["targets[0].prior_au"]),
        ("prior_au: simulated", "prior_au: simulate", 10, ["[x, y] from 0 to 1, or `simulated`"]),
        ("prior_au: simulated", "prior_au: 0.5 0.5", 10, ["[x, y] from 0 to 1, or `simulated`"]),
        (ALTITUDE, "start_au: 0.5 0.5", 6, ["flight.start_au", "[x, y] from 0 to 1"]),
        ("side_m: 200", "latitude_deg: 3", 3, ["area", "longitude_deg"]),
        ("horizon_au: 30", "horizon_au: 30\n  horizon_min: 3", 5, ["flight", "not both"]),
        ("targets:", "targets: [", 10, ["not valid YAML"]),
        ("simulation:", "vehicle:\n  url: 14540\nsimulation:", 16, ["vehicle.url"]),
        ("simulation:", "vehicle: {url: 'udp:1'}\nsimulation:", 15, ["vehicle.url", "udpin://"]),
        (ALTITUDE, "max_speed_m_s: 4.9", 6, ["max_speed_m_s", "4.9 is less than cruise_speed"]),
        (ALTITUDE, "max_acceleration_m_s2: 10", 5, ["altitude_m", "no height will do", "45.6"]),
        ("simulation:", "camera: {url: walk.mp4}\nsimulation:", 15, ["walk.mp4", "no such file"]),
    ],
)
def test_message_names_line_and_key(
    tmp_path: Path, old: str, new: str, line: int, words: list[str]
):
    message = _error(tmp_path, ANIMALS.replace(old, new, 1))
    assert message.startswith(f":{line}: "), message
    for word in words:
        assert word in message


def test_a_gimbal_allows_what_banks_too_much_for_a_fixed_camera(tmp_path: Path):
    """It stays level: 5 degrees that it may be off take 31.9 m of height, 11.5 take 42.2."""
    lower = ANIMALS.replace(ALTITUDE, "altitude_m: 33") + "camera: {gimbal: GIMBAL}\n"
    assert "42.3 m" in _error(tmp_path, lower.replace("GIMBAL", "false"))
    path = tmp_path / "m.yaml"
    path.write_text(lower.replace("GIMBAL", "true"))
    mission = load_checked(str(path), {}, None).mission
    assert needed_altitude_m(mission) == pytest.approx(
        20.0 / math.tan(math.atan(0.75) - 0.0873), 1e-3
    )
    assert "which it is told to look down" in flight_facts(mission)["camera"]
    message = _error(tmp_path, lower.replace("GIMBAL", "true").replace("m: 33", "m: 20"))
    assert "with its gimbal off by 5.0 degrees" in message
    assert "bank" not in message
    assert "cruise" not in message


def test_a_herd_is_one_entry_and_what_is_wrong_behind_it_is_told_by_its_line(tmp_path: Path):
    herd = ANIMALS.replace("appearance: cow, prior_au: simulated", "appearance: cow, count: 3", 1)
    path = tmp_path / "m.yaml"
    path.write_text(herd)
    targets = load_mission(path).mission.targets
    assert [t.name for t in targets] == ["Bella 1", "Bella 2", "Bella 3", "Zuri", "Rusty"]
    assert [t.entry for t in targets] == [0, 0, 0, 1, 2]
    message = _error(tmp_path, herd.replace("name: Rusty", "name: Bella 2"))
    assert message.startswith(":12: targets[2].name: 'Bella 2' is already the name of target 1")


@pytest.mark.parametrize(
    ("confusion", "words"),
    [
        ("{cow: 3}", "confusion.cow"),
        ("{cow: {fox: .nan}}", "confusion.cow.fox"),
        ("{cow: {fox: true}}", "confusion.cow.fox"),
        ("{cow: {cat: 0.1}}", "finds no 'cat'"),
    ],
)
def test_wrong_confusion_is_told(tmp_path: Path, confusion: str, words: str):
    text = ANIMALS.replace("simulation:", f"detector: {{confusion: {confusion}}}\nsimulation:", 1)
    message = _error(tmp_path, text)
    assert message.startswith(":15: "), message
    assert words in message


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
        ("[" * 100_000, "nested too deeply"),
        ("name: a\n" + "- " * 50_000, "not valid YAML"),
        ("name:\n " + "- " * 50_000, "nested too deeply"),
    ],
)
def test_hostile_yaml(tmp_path: Path, text: str, words: str):
    assert words in _error(tmp_path, text)


@pytest.mark.parametrize("text", ["2e2", "2E+2", "+2.e2", "200", "0200.0", ".2e3", "2000e-1"])
def test_numbers_are_read_as_written(tmp_path: Path, text: str):
    path = tmp_path / "m.yaml"
    path.write_text(ANIMALS.replace("side_m: 200", f"side_m: {text}"))
    assert load_mission(path).mission.area.side_m == 200.0


def test_missing_files_and_names(tmp_path: Path):
    for name in (str(tmp_path / "none.yaml"), "animal"):
        with pytest.raises(MissionFileError, match=rf"{name}.*: no such mission, .*animals"):
            find_mission(name)
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


def test_all_that_is_wrong_is_told_at_once_in_the_order_of_the_file(tmp_path: Path):
    text = ANIMALS.replace("side_m:", "sid_m:").replace("name: animals", "name: a\nname: b")
    text = text.replace("seed: 0", "seed: none")
    text = text.replace("appearance: fox, prior_au: simulated", "appearance: fox, prior_au: [2, 3]")
    lines = _error(tmp_path, text).splitlines()
    assert [line.rpartition("m.yaml")[2].split(":")[1] for line in lines] == ["3", "5", "13", "17"]
    assert "name: given twice" in lines[0]
    assert "area.sid_m: no such key; did you mean `side_m`" in lines[1]
    assert "targets[2].prior_au" in lines[2]
    assert "simulation.seed" in lines[3]


def test_what_keys_say_together_is_told_at_once(tmp_path: Path):
    text = ANIMALS.replace(ALTITUDE, "altitude_m: 20").replace("horizon_au: 30", "horizon_au: 60")
    text = text.replace("name: Zuri, appearance: zebra", "name: Bella, appearance: cow")
    lines = _error(tmp_path, text).splitlines()
    assert len(lines) == 3
    for line, words in zip(lines, ("too low", "battery", "name"), strict=True):
        assert words in line


@pytest.mark.parametrize(
    "wrong",
    [
        ("speed_ratio: 0.05", "speed_ratio: fast"),
        ("seed: 0", "sed: 0"),
        ("appearance: fox", "apearance: fox"),
        ("simulation:", "view: {port: 1}\nsimulation:"),
        ("simulation:", "vehicle: {url: nowhere}\nsimulation:"),
        (ALTITUDE, ALTITUDE + "\n  start_au: [0.5, 3]"),
    ],
)
def test_a_wrong_key_hides_nothing_of_what_others_say_together(
    tmp_path: Path, wrong: tuple[str, str]
):
    text = ANIMALS.replace(*wrong).replace("horizon_au: 30", "horizon_au: 60")
    text = text.replace("kind: stamp", "kind: stemp").replace(ALTITUDE, "altitude_m: 300")
    lines = _error(tmp_path, text).splitlines()
    assert len(lines) == 4
    for words in ("battery allows", "too high", "did you mean stamp"):
        assert sum(words in line for line in lines) == 1


def test_what_is_told_of_a_wrong_key_is_told_once(tmp_path: Path):
    for wrong in ("altitude_m: 3 m", "altitud: 3", "altitud: 3 m"):
        assert len(_error(tmp_path, ANIMALS.replace(ALTITUDE, wrong)).splitlines()) == 1
    text = ANIMALS.replace(ALTITUDE, "latitude_deg: no").replace("targets:", "targets: 3\nx:")
    assert len(_error(tmp_path, text).splitlines()) == 3


def test_no_height_and_a_large_side_are_each_one_fact(tmp_path: Path):
    message = _error(tmp_path, ANIMALS + "camera: {horizontal_fov_deg: 10}\n")
    assert len(message.splitlines()) == 1
    assert "no height will do" in message
    message = _error(
        tmp_path,
        ANIMALS.replace("side_m: 200", "side_m: 300").replace("horizon_au: 30", "horizon_au: 9"),
    )
    assert len(message.splitlines()) == 1
    assert "too large" in message


def test_a_misspelt_key_is_not_missing_too(tmp_path: Path):
    message = _error(tmp_path, ANIMALS.replace("appearance: fox", "apearance: fox"))
    assert len(message.splitlines()) == 1


def test_what_came_by_an_option_is_its_fault(tmp_path: Path):
    path = tmp_path / "m.yaml"
    path.write_text(ANIMALS)
    option = {("flight", "horizon_au"): ("--horizon-au", 60.0)}
    with pytest.raises(MissionFileError, match=r"^--horizon-au: take-off, .* battery allows"):
        load_mission(path, option)
    option = {("vehicle", "url"): ("--vehicle", "udp://127.0.0.1:14540")}
    with pytest.raises(MissionFileError, match=r"^--vehicle: .*did you mean udpin://127.0.0.1:145"):
        load_mission(path, option)


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("udpin://127.0.0.1", "such as udpin://127.0.0.1:14540"),
        ("udpin://127.0.0.1:99999", "99999, not 1 to 65535"),
        ("udpin://127.0.0.1:0", "0, not 1 to 65535"),
        ("udp://127.0.0.1:14540", "did you mean udpin://127.0.0.1:14540?"),
        ("tcp://10.0.0.2:5760", "did you mean tcpout://10.0.0.2:5760?"),
        ("127.0.0.1:14540", "did you mean udpin://127.0.0.1:14540?"),
        ("serial://", "serial:///dev/ttyACM0:57600"),
        ("serial:///dev/ttyACM0:fast", "serial:///dev/ttyACM0:57600"),
    ],
)
def test_a_wrong_mavlink_url_is_told_the_right_form(url: str, words: str):
    assert words in str(mavlink_url_problem(url))


@pytest.mark.parametrize(
    "url", ["udpin://0.0.0.0:14540", "udpout://10.0.0.2:1", "tcpin://127.0.0.1:65535"]
)
def test_a_right_mavlink_url_is_taken(url: str):
    assert mavlink_url_problem(url) is None
    assert mavlink_url_problem("serial:///dev/ttyACM0:57600") is None


def test_files_are_found_from_the_mission_and_not_from_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "walk.mp4").touch()
    path = tmp_path / "there" / "m.yaml"
    path.write_text(
        ANIMALS.replace("kind: stamp", "kind: stamp\n  checkpoint: best.pt")
        + "camera: {url: walk.mp4}\n"
    )
    monkeypatch.chdir(tmp_path)
    mission = load_mission(Path("there/m.yaml")).mission
    assert mission.camera.url == str(tmp_path / "there" / "walk.mp4")
    assert mission.planner.checkpoint == str(tmp_path / "there" / "best.pt")


def test_every_key_says_what_it_means():
    schema = Mission.model_json_schema()
    silent = [
        f"{name}.{key}"
        for name, section in {"Mission": schema, **schema["$defs"]}.items()
        for key, value in section["properties"].items()
        if "description" not in value and "$ref" not in value
    ]
    assert silent == []
    assert all("description" in section for section in schema["$defs"].values())


def test_a_mission_to_start_from_says_what_the_schema_says(tmp_path: Path):
    path = tmp_path / "m.yaml"
    path.write_text(mission_template())
    mission = load_mission(path).mission
    for words in (
        *APPEARANCES,
        "Several may have the same",
        "x runs east and y north",
        "`simulated`",
    ):
        assert words in path.read_text()
    assert mission == Mission(targets=mission.targets)
    for section in Mission.model_fields.values():
        for key, field in getattr(section.annotation, "model_fields", {}).items():
            assert f"{key}: " in path.read_text()
            assert field.description in path.read_text()


def test_every_kind_of_fault_is_in_the_guide():
    guide = (ROOT / "docs" / "flying.md").read_text()
    assert [kind for kind in KINDS if f"`{kind}`" not in guide and f"`{kind}=" not in guide] == []


def test_a_wrong_fault_is_named_with_its_line(tmp_path: Path):
    text = ANIMALS + "\nsimulation:\n  faults: [gps@3, storm@4]\n"
    message = _error(tmp_path, text)
    assert "simulation.faults" in message
    assert "'storm@4' is not KIND[=VALUE]" in message


MARKED = """
detector: {kind: markers, family: 4x4_50, SIDE}
targets:
  - {name: Rover, appearance: "7"}
"""


def test_the_simulator_draws_markers_whose_side_is_known(tmp_path: Path):
    path = tmp_path / "m.yaml"
    path.write_text(MARKED.replace("SIDE", "side_m: 1.5"))
    mission = load_mission(path).mission
    assert World(mission).looks == ["4x4_50/7/1.5"]
    message = _error(tmp_path, MARKED.replace(", SIDE", ""))
    assert message.startswith(":2: detector.side_m: is missing; give the side")
    path.write_text(MARKED.replace(", SIDE", "") + "camera: {url: '0'}\n")
    mission = load_mission(path).mission  # of markers that lie there
    assert World(mission).looks == ["7"]


def test_a_number_for_a_word_is_put_in_quotes(tmp_path: Path):
    message = _error(tmp_path, MARKED.replace("SIDE", "side_m: 1.5").replace('"7"', "7"))
    assert "targets[0].appearance" in message
    assert 'but is 7; put it in quotes: "7"' in message


@pytest.mark.parametrize(
    ("side_m", "why"),
    [(0.3, "pixels that the detector needs"), (21.0, "is more than the sensor's radius of 20 m")],
)
def test_markers_that_would_not_be_found_are_refused(tmp_path: Path, side_m: float, why: str):
    assert why in _error(tmp_path, MARKED.replace("SIDE", f"side_m: {side_m}"))


def test_what_is_advised_is_not_refused_again(tmp_path: Path):
    small = (
        MARKED.replace("SIDE", "side_m: 0.4") + "flight: {altitude_m: 45, cruise_speed_m_s: 2}\n"
    )
    told = _error(tmp_path, small)
    side_m = re.search(r"make it ([0-9.]+) m or less", told)[1]
    told = _error(tmp_path, f"area: {{side_m: {side_m}}}\n{small}")
    least_m, most_m = re.search(r"fly at ([0-9.]+) to ([0-9.]+) m", told).groups()
    assert float(least_m) <= float(most_m)
    for height_m in (least_m, most_m):
        text = f"area: {{side_m: {side_m}}}\n{small.replace('45', height_m)}"
        (tmp_path / "m.yaml").write_text(text)
        load_checked(str(tmp_path / "m.yaml"), {}, None)


def test_only_a_flight_asks_what_the_simulator_draws(tmp_path: Path):
    text = "detector: {kind: blobs, saturation: 0.5}\ntargets: [{name: A, appearance: buoy}]\n"
    assert "'buoy' is none of what the simulator draws" in _error(tmp_path, text)
    assert load_mission(tmp_path / "m.yaml").mission.targets[0].appearance == "buoy"
