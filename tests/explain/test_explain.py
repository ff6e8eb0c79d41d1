"""A decision of a recorded flight is made again as it was flown, and drawn."""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import virtual_time
from fake_link import FakeCamera, FakeLink

from dronemon import cli
from dronemon.errors import DronemonError, OptionError, RecordError
from dronemon.events import Audience, Decided, Event
from dronemon.explain import video
from dronemon.explain.figure import caption, draw
from dronemon.explain.replay import replay
from dronemon.mission import load_mission
from dronemon.planner.learned import LearnedPlanner
from dronemon.policy import Card, NetworkConfig, PolicyNetwork, save_checkpoint
from dronemon.recorder import RunFolder, RunRecorder
from dronemon.runner.flight import fly_mission
from dronemon.runner.history import read_history
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.preparation import FlightSetup
from dronemon.types import Detection, ImageArray, Pose

MISSION = """
name: small
area: {side_m: 100}
flight: {altitude_m: 22, cruise_speed_m_s: 5, horizon_au: 2, start_au: [0.5, 0.4]}
targets:
  - {name: Bella, appearance: cow, prior_au: [0.4, 0.6]}
  - {name: Zuri, appearance: zebra}
roadmap: {num_nodes: 40, num_neighbours: 6}
planner: {kind: stamp, checkpoint: tiny.pt, history: 8}
sensor: {miss: 0.3, false_alarms: 0.02}  # pictures change what was believed of earlier ones
"""
PRIORS_AU = np.array([[0.4, 0.6], [np.nan, np.nan]])
INTERRUPTED_AFTER = 7
CARD = Card(recipe="none", command="", commit="", date="", seeds="")


class Sometimes:
    """Sees the cow below itself in every third picture."""

    count = 0

    def detect(self, image: object, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        self.count += 1
        if self.count % 3:
            return ()
        return (Detection(appearance="cow", pixel_px=(320.0, 240.0), score=0.9),)


class Impatient:
    """A person who ends the flight after so many decisions."""

    lost = ""

    def __init__(self, interrupts: Interrupts, most: int) -> None:
        self.interrupts, self.left = interrupts, most

    def take(self, event: Event) -> None:
        if isinstance(event, Decided):
            self.left -= 1
            if self.left == 0:
                self.interrupts.request()


def write_weights(path: Path, seed: int, **ours: bool) -> None:
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        config = NetworkConfig(width=16, feed_forward=24, stride=2, **ours)
        save_checkpoint(path, PolicyNetwork(config), CARD)


async def fly(folder: Path, most: int, *, is_new: bool) -> None:
    file, path = load_mission(folder / "small.yaml"), folder / "run"
    mission, interrupts = file.mission, Interrupts()
    recorder = (
        RunRecorder.create(mission, out=path)
        if is_new
        else RunRecorder.resume(RunFolder(path=path), mission)
    )
    with recorder:
        async with FakeLink() as link:
            result = await fly_mission(
                FlightSetup(
                    file=file,
                    link=link,
                    camera=FakeCamera(link, 640, 480),
                    detector=Sometimes(),
                    planner=LearnedPlanner.load(
                        mission.planner.checkpoint, mission.planner.history
                    ),
                    priors_au=PRIORS_AU,
                    record=recorder,
                    audience=Audience((Impatient(interrupts, most),)),
                    interrupts=interrupts,
                    history=None
                    if is_new
                    else read_history(RunFolder(path=path), mission, PRIORS_AU),
                )
            )
        recorder.finish(result.outcome, {})


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two flights: the first is interrupted, the second goes on."""
    folder = tmp_path_factory.mktemp("flown")
    write_weights(folder / "tiny.pt", 1, newest=True, ways=True, geometry=True, tracks=True)
    (folder / "small.yaml").write_text(MISSION)
    for most, is_new in ((INTERRUPTED_AFTER, True), (0, False)):
        virtual_time.run(fly(folder, most, is_new=is_new))
    return folder / "run"


@pytest.fixture
def run(flown: Path, tmp_path: Path) -> Path:
    """A copy, to be spoilt."""
    shutil.copytree(flown, tmp_path / "run")
    return tmp_path / "run"


def lines(run: Path, name: str) -> list[dict[str, object]]:
    return [json.loads(line) for line in (run / name).read_text().splitlines()]


@pytest.mark.lengthy
def test_a_decision_comes_out_as_it_was_flown(flown: Path) -> None:
    decisions = lines(flown, "decisions.jsonl")
    first = INTERRUPTED_AFTER
    for number in (1, first, first + 1, len(decisions)):  # of the first flight, of the second
        decision = decisions[number - 1]
        again = replay(RunFolder.open(flown), number)
        own = again.explanation
        assert again.logit_error < 1e-6
        assert own.nodes[1 + own.pointer.argmax()] == again.chosen == decision["node"]
        assert own.nodes[1:].tolist() == decision["details"]["neighbours"]
        assert len(again.path_au) == decision["num_measurements"]
        remembered = number if number <= first else number - first
        assert len(own.ages_au) == min((remembered + 1) // 2, 4)  # stride 2, history 8


@pytest.mark.lengthy
def test_the_command_writes_arrays_and_a_picture(
    flown: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["dronemon", "explain", str(flown), "--out", str(tmp_path / "why")]
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert not caught.value.code
    decisions = lines(flown, "decisions.jsonl")
    stem = tmp_path / "why" / f"decision-{len(decisions)}"
    told = " ".join(capsys.readouterr().out.split())
    assert f"Decision {len(decisions)} at" in told
    assert f"to node {decisions[-1]['node']} (p" in told
    assert stem.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    with np.load(stem.with_suffix(".npz")) as arrays:
        assert all(array.dtype != object for array in arrays.values())
        weights = ["target", "temporal", "spatial", "targets", "tracks", "decoder", "pointer"]
        for name in weights:
            np.testing.assert_allclose(arrays[name].sum(-1), 1.0, atol=1e-5)
        assert arrays["spatial"].shape[-1] == len(arrays["nodes_au"]) == 41
        assert arrays["target"].shape == (41, 4, 2)
        assert arrays["target_names"].tolist() == ["Bella", "Zuri"]
        assert arrays["chosen"] == decisions[-1]["node"]
        assert (np.diff(arrays["ages_au"]) < 0.0).all()


@pytest.mark.lengthy
def test_a_network_with_neither_tracks_nor_attention_to_the_past_is_drawn(
    tmp_path: Path,
) -> None:
    with torch.random.fork_rng():
        torch.manual_seed(2)
        config = NetworkConfig(width=16, feed_forward=24, temporal="lstm")
        save_checkpoint(tmp_path / "tiny.pt", PolicyNetwork(config), CARD)
    (tmp_path / "small.yaml").write_text(MISSION.replace("horizon_au: 2", "horizon_au: 0.5"))
    virtual_time.run(fly(tmp_path, 0, is_new=True))
    again = replay(RunFolder.open(tmp_path / "run"), None)
    assert {"temporal", "ages_au", "tracks", "targets"}.isdisjoint(again.arrays())
    assert "the past" not in caption(again)
    draw(again, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000


def replace(run: Path, name: str, old: str, new: str) -> None:
    text = (run / name).read_text()
    assert old in text
    (run / name).write_text(text.replace(old, new))


def drop_line(run: Path, name: str, index: int) -> None:
    kept = (run / name).read_text().splitlines(keepends=True)
    del kept[index]
    (run / name).write_text("".join(kept))


SPOILT: dict[str, tuple[Callable[[Path], object], type[DronemonError], str]] = {
    "another planner": (
        lambda run: replace(run, "mission.yaml", "kind: stamp", "kind: tsp"),
        OptionError,
        "'tsp', which has no attention",
    ),
    "no decisions": (
        lambda run: (run / "decisions.jsonl").unlink(),
        RecordError,
        "it has no decisions.jsonl",
    ),
    "not begun": (
        lambda run: (run / "decisions.jsonl").write_text(""),
        RecordError,
        "no decision was made",
    ),
    "of an older version": (
        lambda run: replace(run, "decisions.jsonl", "num_measurements", "num_pictures"),
        RecordError,
        "not those of this version",
    ),
    "a decision lost": (
        lambda run: drop_line(run, "decisions.jsonl", 1),
        RecordError,
        "not all of which are recorded",
    ),
    "pictures lost": (
        lambda run: (run / "observations.jsonl").write_text(""),
        RecordError,
        "of which 0 are recorded",
    ),
    "other weights": (
        lambda run: write_weights(Path(checkpoint_of(run)), 5),
        RecordError,
        "comes out otherwise",
    ),
}


def checkpoint_of(run: Path) -> str:
    """Weights of its own, in place of the shared ones."""
    own = str(run.parent / "own.pt")
    shared = load_mission(run / "mission.yaml").mission.planner.checkpoint
    replace(run, "mission.yaml", str(shared), own)
    return own


@pytest.mark.parametrize("case", SPOILT)
def test_what_cannot_be_explained_is_refused(run: Path, case: str) -> None:
    spoil, error, words = SPOILT[case]
    spoil(run)
    with pytest.raises(error, match=words):
        replay(RunFolder.open(run), 3)


@pytest.mark.parametrize("number", [0, -1, 1000])
def test_a_decision_that_is_not_there_is_refused(flown: Path, number: int) -> None:
    count = len(lines(flown, "decisions.jsonl"))
    with pytest.raises(OptionError, match=f"--decision {number}: .* has {count}, counted from 1"):
        replay(RunFolder.open(flown), number)


def test_a_folder_that_is_no_run_has_its_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["dronemon", "explain", str(tmp_path), "--out", str(tmp_path)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == RecordError.exit_code
    assert "no run folder" in capsys.readouterr().err


@pytest.mark.lengthy
@pytest.mark.parametrize("name", ["film.mp4", "film.gif"])
def test_every_decision_is_filmed(
    flown: Path, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dronemon.explain.video._DPI", 20)
    with pytest.raises(SystemExit) as ended:
        cli.app(["video", str(flown), "--to", str(tmp_path / name)], standalone_mode=False)
    assert ended.value.code == 0
    film = cv2.VideoCapture(str(tmp_path / name))
    frames = []
    while (read := film.read())[0]:
        frames.append(read[1])
    film.release()
    assert len(frames) == len(lines(flown, "decisions.jsonl"))
    assert frames[0].std() > 5.0
    assert np.abs(frames[0].astype(float) - frames[-1]).mean() > 1.0


@pytest.mark.parametrize("name", ["film.avi", "there.gif"])
def test_a_film_that_cannot_be_made_is_refused(flown: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "there.gif").write_text("")
    with pytest.raises(OptionError, match=r"--to .*(ends with|is there already)"):
        cli.app(["video", str(flown), "--to", str(tmp_path / name)], standalone_mode=False)


def test_a_film_that_is_cut_short_is_not_left_behind(
    flown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write_some(frames: Iterator[ImageArray], path: Path, rate: float) -> None:
        write(itertools.islice(frames, 2), path, rate)  # as OpenCV does on a full disk: silently

    write = video._write_mp4
    monkeypatch.setattr(video, "_DPI", 20)
    monkeypatch.setattr(video, "_write_mp4", write_some)
    with pytest.raises(OptionError, match="is the disk full"):
        cli.app(["video", str(flown), "--to", str(tmp_path / "a.mp4")], standalone_mode=False)
    assert list(tmp_path.iterdir()) == []
