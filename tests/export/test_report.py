"""The report of a flight: everything in one file, true to the record, whatever the names are."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import virtual_time
from small_flight import fly

from dronemon import cli
from dronemon.errors import OptionError, RecordError
from dronemon.export.story import read_story
from dronemon.planner import create_planner
from dronemon.recorder import RunFolder
from dronemon.report.flight import GRID_SIZE, read_flight
from dronemon.report.picture import draw


class Page(HTMLParser):
    """What a page refers to, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.references: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.references += [value or "" for name, value in attrs if name in {"src", "href"}]

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def report(*options: object) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.app(["report", *map(str, options)], standalone_mode=False)
    assert ended.value.code == 0


@pytest.mark.lengthy
def test_a_page_needs_nothing_else_and_says_what_was_seen(flown: Path, tmp_path: Path) -> None:
    report(flown, "--out", tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    page = Page(text)
    words = " ".join(" ".join(page.words).split())
    assert all(reference.startswith("#") for reference in page.references), page.references
    assert "script" not in page.tags
    assert "url(http" not in text
    assert page.tags.count("svg") == 3
    assert len(text) < 3e6
    assert "Reserve & <north>" in words
    num_seen = len(read_flight(RunFolder.open(flown)).story.sightings)
    assert f"Bella <1> (cow) {num_seen} times" in words
    assert r"_Zürä $\frac{$ (zebra) never" in words
    assert "Outcome: completed. The drone is down." in words
    for svg in text.split("<svg")[1:]:  # whole, whatever the names are
        ElementTree.fromstring("<svg" + svg[: svg.index("</svg>")] + "</svg>")
    assert (tmp_path / "page.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.lengthy
def test_a_redacted_page_says_nowhere_exactly_where(flown: Path, tmp_path: Path) -> None:
    report(flown, "--out", tmp_path / "page.html", "--redact", "1000")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    whole = read_story(RunFolder.open(flown))
    for place in (*whole.corners, *(s.place for s in whole.sightings)):
        assert f"{place.latitude_deg:.6f}" not in text
        assert f"{place.longitude_deg:.6f}" not in text
    words = " ".join(" ".join(Page(text).words).split())
    assert "places to 1000 m" in words
    assert re.search(r"± 7\d\d", words)
    assert "as it may say where" in words
    assert str(flown.parent) not in text


def test_a_picture_that_is_not_the_reports_is_kept(flown: Path, tmp_path: Path) -> None:
    (tmp_path / "page.png").write_text("precious")
    for out, words in (("page.html", "is there already"), ("page.png", r"ends with \.html")):
        with pytest.raises(OptionError, match=words):
            report(flown, "--out", tmp_path / out)
    assert (tmp_path / "page.png").read_text() == "precious"


def test_what_the_report_reckons(flown: Path) -> None:
    flight = read_flight(RunFolder.open(flown))
    seen_once, never = flight.watched
    assert seen_once.num_seen == flight.seen[:, 0].sum() == len(flight.times_s)
    assert never.num_seen == 0
    assert (flight.std[:, 0] < 0.5).all()  # seen in every picture
    assert np.isnan(flight.std[:, 1]).all()
    # A disc of 0.1 au, and what it sweeps in 1 au of straight lines at most.
    assert 0.1 < flight.share_looked_at() < 0.035 + 0.2
    assert flight.share_looked_at(1.0) < flight.share_looked_at()
    last = round_to_grid(flight.seen_au[-1, 0])
    assert flight.mean[0][last] > 0.9
    assert flight.mean[0][last[::-1]] < 0.3  # rows are y
    assert flight.unseen_for_s[last] == 0.0


def test_what_a_tilted_picture_did_not_show_was_not_looked_at(flown: Path, tmp_path: Path) -> None:
    """And a run of a version that did not say so was looked at as far as the sensor sees."""

    def share(change: Callable[[dict], object]) -> float:
        run = tmp_path / "run"
        shutil.copytree(flown, run, dirs_exist_ok=True)
        told = (flown / "observations.jsonl").read_text().splitlines()
        lines = [json.loads(line) for line in told]
        for line in lines:
            change(line)
        (run / "observations.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
        return read_flight(RunFolder.open(run)).share_looked_at()

    whole = read_flight(RunFolder.open(flown)).share_looked_at()
    assert share(lambda line: line.pop("view_au")) == whole
    assert share(lambda line: line.update(view_au=0.05)) < 0.7 * whole
    west = [[0.1, 0.1]] * 18 + [[0.0, 0.1]] * 36 + [[0.1, 0.1]] * 18
    assert share(lambda line: line.update(view_au=0.0, hidden_au=west)) < 0.9 * whole
    clear = [[0.1, 0.1]] * 72
    assert share(lambda line: line.update(view_au=0.0, hidden_au=clear)) == whole


def round_to_grid(place_au: np.ndarray) -> tuple[int, ...]:
    column, row = np.rint(place_au * (GRID_SIZE - 1)).astype(int)
    return int(row), int(column)


def test_a_run_that_ended_badly_is_told(flown: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(flown, run)
    summary = json.loads((run / "summary.json").read_text())
    kept = {key: summary[key] for key in ("started", "code", "targets")}
    (run / "summary.json").write_text(json.dumps(kept | {"outcome": "in flight"}))
    report(run)
    words = " ".join(Page((run / "report.html").read_text(encoding="utf-8")).words)
    assert "Outcome: in flight. Nobody saw the drone land." in words


def test_what_cannot_be_told_says_so(flown: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="cannot be written"):
        report(flown, "--out", "/proc/none/page.html")
    run = tmp_path / "run"
    shutil.copytree(flown, run)
    (run / "observations.jsonl").write_text("")
    with pytest.raises(RecordError, match="nothing is there to tell"):
        report(run)


def test_runs_are_compared(flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other"
    shutil.copytree(flown, other)
    summary = json.loads((other / "summary.json").read_text())
    (other / "summary.json").write_text(json.dumps(summary | {"unc": 0.25, "pictures": None}))
    for options in ((), ("--json",)):
        with pytest.raises(SystemExit):
            cli.app(["compare", str(flown), str(other), *options], standalone_mode=False)
    shown, _, told = capsys.readouterr().out.partition("[\n")
    rows = json.loads("[" + told)
    assert [row["run"] for row in rows] == ["run", "other"]
    assert [row["unc"] for row in rows] == [None, 0.25]
    assert rows[0]["longest_unseen_s"] == pytest.approx(20.0, abs=1.0)
    cells = [line.split("│")[1:-1] for line in shown.splitlines() if line.startswith("│")]
    table = {first.strip(): [cell.strip() for cell in rest] for first, *rest in cells}
    assert table["Unc"] == ["-", "0.250"]
    assert table["pictures"] == ["10", "-"]
    assert table["longest out of sight"] == ["20 s", "20 s"]


@pytest.mark.lengthy
@pytest.mark.parametrize("has_truth", [False, True])
def test_a_moment_is_drawn(flown: Path, tmp_path: Path, has_truth: bool) -> None:
    run = tmp_path / "run"
    shutil.copytree(flown, run)
    if has_truth:
        seen = RunFolder.open(run).observations()
        told = [{"time_s": o["time_s"], "targets_au": [[0.3, 0.3], [0.8, 0.8]]} for o in seen]
        (run / "truth.jsonl").write_text("".join(json.dumps(t) + "\n" for t in told))
    for name, options in (("a.png", ()), ("b.svg", ("--at", "0.5")), ("c.pdf", ("--at", "0"))):
        words = ["picture", str(run), "--to", str(tmp_path / name), *options]
        with pytest.raises(SystemExit) as ended:
            cli.app(words, standalone_mode=False)
        assert ended.value.code == 0
        assert (tmp_path / name).stat().st_size > 10_000
    folder = RunFolder.open(run)
    panels = {panel.get_title(): panel for panel in draw(folder, read_flight(folder), 3).axes}
    marks = panels["where the targets truly are" + ("" if has_truth else ": not known")].lines
    assert [mark.get_xydata().tolist() for mark in marks] == [[[0.3, 0.3]], [[0.8, 0.8]]][
        : 2 * has_truth
    ]
    camera = panels["the camera, and whom it found"]
    assert camera.images[0].get_array().shape == (480, 640, 3)
    assert [text.get_text() for text in camera.texts] == ["Bella <1> 0.90"]
    way = panels["all beliefs, and the way flown"]
    assert way.lines[0].get_xydata()[0] == pytest.approx(read_flight(folder).agent_au[2])
    for options, message in (
        (("--at", "5"), "last picture"),
        (("--to", "x.doc"), "ends with"),
    ):
        words = ["picture", str(run), "--to", str(tmp_path / "c.png"), *options]
        with pytest.raises(OptionError, match=message):
            cli.app(words, standalone_mode=False)


@pytest.mark.lengthy
@pytest.mark.parametrize("kind", ["lawnmower", "search"])
def test_a_planner_that_is_asked_again_answers_as_it_flew(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    virtual_time.run(fly(tmp_path, create_planner(kind)))
    decisions = list(RunFolder.open(tmp_path / "run").decisions())
    own = replay(tmp_path / "run", kind, tmp_path / "own")
    assert "the same waypoint" in capsys.readouterr().out
    for row, decision in zip(own, decisions, strict=True):
        for what, key in (
            ("flown", "waypoint_au"),
            ("otherwise", "waypoint_au"),
            ("place", "position_au"),
        ):
            told = float(row[f"{what}_x_au"]), float(row[f"{what}_y_au"])
            assert told == pytest.approx(decision[key], abs=1e-9)
    other = replay(tmp_path / "run", "tsp", tmp_path / "other")
    assert any(a["otherwise_x_au"] != b["otherwise_x_au"] for a, b in zip(own, other, strict=True))


def replay(run: Path, planner: str, to: Path) -> list[dict[str, str]]:
    words = ["replay", str(run), "--planner", planner, "--to", str(to)]
    with pytest.raises(SystemExit):
        cli.app(words, standalone_mode=False)
    assert (to / "replay.png").read_bytes().startswith(b"\x89PNG")
    return list(csv.DictReader((to / "replay.csv").read_text().splitlines()))


def test_what_cannot_be_replayed_says_so(flown: Path, tmp_path: Path) -> None:
    for planner, words in (("none such", "none such"), ("clairvoyant", "told the future")):
        with pytest.raises(OptionError, match=words):
            cli.app(
                ["replay", str(flown), "--planner", planner, "--to", str(tmp_path)],
                standalone_mode=False,
            )
