"""The report as one HTML file: everything is in it, and nothing is asked of a network."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import jinja2
from matplotlib.colors import to_hex

from dronemon.palette import on_paper
from dronemon.problem import LOST_STD
from dronemon.recorder import MISSION_FILE, REWATCHED
from dronemon.report.figures import FIGURES, svg
from dronemon.report.flight import RECENTLY_S, Flight
from dronemon.runner.summary import figures, how_flown
from dronemon.runner.watch import ago_in_words, seen_in_words, span

_MAX_EVENTS = 150


def page(flight: Flight) -> str:
    """The whole page."""
    summary, story = flight.summary, flight.story
    template = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    ).from_string((files("dronemon.report") / "page.html.j2").read_text(encoding="utf-8"))
    drawn = {name: svg(draw(flight)) for name, draw in FIGURES.items()}
    return template.render(
        title=story.title,
        day=f"{story.started:%Y-%m-%d}",
        began=f"{story.started:%Y-%m-%d %H:%M:%S}",
        ended=f"{story.track[-1].time:%H:%M:%S}" if story.track else "",
        outcome=_outcome(summary, is_whole=not story.cell_m),
        is_bad=not (summary.get("is_landed") or REWATCHED in summary) or bool(summary.get("error")),
        targets=[_target(flight, number) for number in range(len(flight.names))],
        coverage=_coverage(flight),
        recently=span(RECENTLY_S),
        lost_std=f"{LOST_STD:g}",
        map=drawn["map"],
        targets_figure=drawn["targets"],
        vehicle=drawn["vehicle"],
        flight=list(how_flown(summary).items()),
        figures=list(figures(summary).items()),
        events=[_event(event) for event in flight.events[:_MAX_EVENTS]],
        num_left_out=max(0, len(flight.events) - _MAX_EVENTS),
        made=list(_made(flight).items()),
    )


def _outcome(summary: Mapping[str, Any], *, is_whole: bool) -> str:
    """How it ended, in a sentence; its error, which may say where, only where all is told."""
    landed = "The drone is down." if summary.get("is_landed") else "Nobody saw the drone land."
    if REWATCHED in summary:
        landed = "Nothing was flown: these are pictures of an earlier flight."
    error = f" {summary['error']}" if is_whole and summary.get("error") else ""
    return f"Outcome: {summary['outcome']}. {landed}{error}"


def _target(flight: Flight, number: int) -> dict[str, str]:
    target, watched = flight.mission.targets[number], flight.watched[number]
    return {
        "name": target.name,
        "appearance": target.appearance,
        "color": to_hex(on_paper(number)),
        "seen": seen_in_words(watched.num_seen),
        "longest": span(watched.longest_unseen_s),
        "last": "-" if watched.unseen_since_s is None else ago_in_words(watched.unseen_since_s),
        "where": "-" if watched.place is None else str(watched.place) + _error(flight, number),
    }


def _error(flight: Flight, number: int) -> str:
    errors_m = [s.error_m for s in flight.story.sightings if s.number == number]
    return f" ± {errors_m[-1]:.1f} m" if errors_m else ""


def _coverage(flight: Flight) -> str:
    ever, lately = flight.share_looked_at(), flight.share_looked_at(RECENTLY_S)
    return (
        f"Of the area {ever:.0%} was looked at at least once, {lately:.0%} in the last"
        f" {span(RECENTLY_S)}."
        " A target that stood still there would have been seen, if the detector misses none."
    )


def _event(event: Mapping[str, Any]) -> dict[str, str]:
    time_s = event["time_s"]
    shown = "" if time_s is None else f"{int(time_s // 60)}:{time_s % 60:04.1f}"
    return {"time": shown, "kind": event["kind"], "text": event["text"]}


def _made(flight: Flight) -> dict[str, str]:
    summary, run = flight.summary, flight.folder.path.resolve().name
    made = {"this page": f"dronemon report {shlex.quote(run)}"}
    if REWATCHED in summary:
        return {"looked at by": f"dronemon {summary['code']}", **made}
    made = {
        "flown by": f"dronemon {summary['code']}, planner {flight.mission.planner.kind}",
        "fly it again": f"dronemon fly {shlex.quote(f'{run}/{MISSION_FILE}')}",
        **made,
    }
    if "checkpoint" in summary:
        made["weights"] = "{name}, SHA-256 {sha256}".format(**summary["checkpoint"])
    return made
