"""Planners in fields of any form: `python benchmarks/fields.py --out DIR [--flights]`.

Episodes: concave polygons 1 to 2.5 au across with 1 to 4 no-fly zones, each flown on the same
instances by every planner. Every leg is judged by plain shapely, not by our arena. What is flown is
in DIR/episodes.jsonl and not flown again; DIR/fields.md and fields.csv say what came of it.
Decision times are processor time of the deciding thread. Standard errors are those over polygons.
Flights: see `benchmarks/field_flights.py`; in DIR/flights.jsonl, and in the same table.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import field_flights
import numpy as np
from drawn_fields import TOLERANCE_AU, corners, draw_field, how_kept

from dronemon.evaluation.episode import Conditions, fly_episode
from dronemon.evaluation.markdown import markdown_table
from dronemon.planner import create_planner
from dronemon.problem import FIRST_DEVELOPMENT_SEED, MOTIONS
from dronemon.types import FloatArray
from dronemon.version import code_version
from dronemon.workers import num_cores, share_out
from dronemon.world import Instance

PLANNERS = ("lawnmower", "tsp", "search", "clairvoyant-search")
NUM_TARGETS = 4
SPEED_RATIO = 0.1
WANTED_SHARE = 0.6
"""Of the way from the lawnmower to the clairvoyant that search is to cover."""
Result = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One episode, and by what it is known in the file."""

    planner: str
    polygon: int
    seed: int
    motion: str
    horizon_au: float


def fly(spec: Spec) -> Result:
    """Fly one episode. -> what came of it, decisions in ms"""
    arena = draw_field(spec.polygon)
    instance = Instance.draw(spec.seed, NUM_TARGETS, spec.motion, arena=arena)
    planner = create_planner(spec.planner)
    track_au, decisions_ms = [instance.start_au], []
    decide = planner.next_waypoint

    def watched(snapshot: Any) -> Any:
        began_ns = time.thread_time_ns()
        waypoint = decide(snapshot)
        decisions_ms.append((time.thread_time_ns() - began_ns) / 1e6)
        track_au.append(np.array(waypoint.position_au))
        return waypoint

    planner.next_waypoint = watched  # a class around it would hide whether it is clairvoyant
    episode = fly_episode(
        planner, instance, Conditions(speed_ratio=SPEED_RATIO, horizon_au=spec.horizon_au)
    )
    kept = how_kept(np.stack(track_au), *corners(arena), TOLERANCE_AU)
    scores = episode.metrics().scores
    return {
        **asdict(spec),
        "unc": scores.unc,
        "jsd": scores.jsd,
        "min_ob": scores.min_ob,
        **asdict(kept),
        "decisions_ms": np.round(decisions_ms, 2).tolist(),
        "code": code_version(),
    }


def main() -> None:
    """Fly what is not flown yet, and write the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--planners", nargs="+", choices=PLANNERS, default=list(PLANNERS))
    parser.add_argument("--polygons", type=int, default=20)
    parser.add_argument("--instances", type=int, default=5, help="on each polygon")
    parser.add_argument(
        "--first-seed",
        type=int,
        default=FIRST_DEVELOPMENT_SEED,
        help="of polygons and of instances; 0 for the reported run",
    )
    parser.add_argument("--motion", choices=MOTIONS, default="waypoints")
    parser.add_argument("--length", type=float, default=30.0, help="of an episode in au")
    parser.add_argument("--workers", type=int, default=num_cores(), help="processes")
    parser.add_argument("--flights", action="store_true", help="fly some of them on the mock, too")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    results = _flown(options)
    flights = field_flights.flown(
        options.out / "flights.jsonl", options.flights, options.first_seed
    )
    sections = [*_summary(results, options), *field_flights.section(flights)]
    (options.out / "fields.md").write_text("\n".join(sections), encoding="utf-8")
    _write_csv(options.out / "fields.csv", results)
    print("\n".join(sections))
    num_bad = sum(r["num_bad"] for r in results) + sum(map(field_flights.is_bad, flights))
    sys.exit(num_bad > 0)


def _flown(options: argparse.Namespace) -> list[Result]:
    """The episodes asked for. All polygons' first instances come first, so a part says most."""
    first = options.first_seed
    specs = [
        Spec(planner=name, polygon=p, seed=s, motion=options.motion, horizon_au=options.length)
        for s in range(first, first + options.instances)
        for p in range(first, first + options.polygons)
        for name in options.planners
    ]
    path = options.out / "episodes.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    done = {_spec(result): result for result in map(json.loads, lines)}
    missing = [spec for spec in specs if spec not in done]
    if missing and (others := {r["code"] for r in done.values()} - {code_version()}):
        sys.exit(f"{path}: of {', '.join(others)}, this is {code_version()}; choose other --out")
    for result in share_out(fly, missing, options.workers):
        done[_spec(result)] = result
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(result) + "\n")
        print(
            f"{len(done)}/{len(specs)} polygon {result['polygon']} seed {result['seed']} "
            f"{result['planner']}: Unc {result['unc']:.3f}, {result['num_bad']} legs astray",
            file=sys.stderr,
            flush=True,
        )
    return [done[spec] for spec in specs]


def _spec(result: Result) -> Spec:
    return Spec(**{name: result[name] for name in Spec.__dataclass_fields__})


def _by_polygon(results: Iterable[Result], planner: str, score: str) -> FloatArray:
    """Mean of each polygon's instances, in order. -> (P,)."""
    values: dict[int, list[float]] = {}
    for result in results:
        if result["planner"] == planner:
            values.setdefault(result["polygon"], []).append(result[score])
    return np.array([np.mean(values[polygon]) for polygon in sorted(values)])


def _told(values: FloatArray, digits: int) -> str:
    """Mean and standard error."""
    error = values.std(ddof=1) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return f"{values.mean():.{digits}f} ± {error:.{digits}f}"


def _share(results: list[Result], score: str) -> str:
    """How much of the way between the bounds search covers, with its jackknife error."""
    worst, ours, best = (
        _by_polygon(results, name, score) for name in ("lawnmower", "search", "clairvoyant-search")
    )
    gained, possible = worst - ours, worst - best
    left_out = (gained.sum() - gained) / (possible.sum() - possible)
    error = math.sqrt((len(left_out) - 1) * left_out.var())
    return f"{gained.sum() / possible.sum():.0%} ± {error:.0%}"


def _summary(results: list[Result], options: argparse.Namespace) -> list[str]:
    polygons = sorted({result["polygon"] for result in results})
    last = options.first_seed + options.instances - 1
    lines = [
        "# Fields\n",
        f"Written by `python benchmarks/fields.py`, which says what is drawn and judged: "
        f"{len(polygons)} polygons (seeds {polygons[0]} to {polygons[-1]}), instances "
        f"{options.first_seed} to {last} on each, N = {NUM_TARGETS}, r_v = {SPEED_RATIO:g}, "
        f"{options.length:g} au, motion {options.motion}; code "
        f"{', '.join(sorted({result['code'] for result in results}))}.\n",
    ]
    rows = []
    for name in options.planners:
        own = [result for result in results if result["planner"] == name]
        decisions_ms = np.concatenate([result["decisions_ms"] for result in own])
        p50, p99 = np.percentile(decisions_ms, [50, 99])
        rows.append(
            [
                name,
                *(_told(_by_polygon(own, name, s), 3) for s in ("unc", "jsd")),
                _told(_by_polygon(own, name, "min_ob"), 1),
                f"{p50:.1f}, {p99:.1f}",
                f"{sum(r['num_bad'] for r in own)} of {sum(r['num_legs'] for r in own)}",
                f"{min(r['zone'] for r in own):.4f}, {min(r['border'] for r in own):.4f}",
            ]
        )
    header = "planner|Unc|JSD|MinOb|decision p50, p99 in ms|legs astray|nearest to zone, border, au"
    lines += markdown_table(header.split("|"), rows)
    if set(PLANNERS) <= set(options.planners):
        shares = " in Unc and ".join(_share(results, score) for score in ("unc", "jsd"))
        lines += [
            f"Of the way from the lawnmower to clairvoyant-search, search covers {shares} in JSD "
            f"(wanted: {WANTED_SHARE:.0%}).\n",
            *markdown_table(_COLUMNS, sorted(_rows(results), key=lambda row: float(row[-1]))),
        ]
    return lines


_COLUMNS = ("polygon", "width", "height", "field, au²", "free, au²", "zones", *PLANNERS, "share")
"""Of the table of polygons: sizes in au, Unc of each planner, and the share of the way."""


def _rows(results: list[Result]) -> list[list[str]]:
    """A row of each polygon."""
    rows = []
    for polygon in sorted({result["polygon"] for result in results}):
        arena = draw_field(polygon)
        own = [result for result in results if result["polygon"] == polygon]
        unc = {name: _by_polygon(own, name, "unc")[0] for name in PLANNERS}
        share = (unc["lawnmower"] - unc["search"]) / (unc["lawnmower"] - unc["clairvoyant-search"])
        sizes = [*arena.extent_au, arena.field.area_au2, arena.free.area_au2]
        rows.append(
            [
                str(polygon),
                *(f"{size:.2f}" for size in sizes),
                str(len(arena.no_fly_au)),
                *(f"{unc[name]:.3f}" for name in PLANNERS),
                f"{share:.2f}",
            ]
        )
    return rows


def _write_csv(path: Path, results: list[Result]) -> None:
    """A line of each episode, with p50 and p99 of its decisions."""
    with path.open("w", encoding="utf-8", newline="") as file:
        names = [name for name in results[0] if name != "decisions_ms"]
        writer = csv.DictWriter(file, [*names, "p50_ms", "p99_ms"], extrasaction="ignore")
        writer.writeheader()
        for result in results:
            p50, p99 = np.percentile(result["decisions_ms"], [50, 99])
            writer.writerow(result | {"p50_ms": f"{p50:.2f}", "p99_ms": f"{p99:.2f}"})


if __name__ == "__main__":
    main()
