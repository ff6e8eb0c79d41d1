"""Flights over drawn fields on the mock, judged by the poses that were recorded.

Each flight is one `dronemon fly` of a mission that lays a polygon of `drawn_fields` in metres, with
home in the middle of where the drone may be, at five times real time. From arming to the end no
pose, and no straight line between two, may be in a no-fly zone or outside the border. How near the
drone came is told beside what its legs keep clear by, the mission's `flight.clearance_m`.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from drawn_fields import corners, draw_field, how_kept
from faults import Spawned, wait_until

from dronemon.errors import DronemonError
from dronemon.evaluation.markdown import markdown_table
from dronemon.mission import load_mission
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.recorder import RunFolder
from dronemon.types import FloatArray
from dronemon.version import code_version

SPEED_UP = 5.0
ALTITUDE_M = 105.0
"""From where the camera shows the larger of the sensor's radii, and cars are large enough."""
HORIZON_AU = 1.5
_AU_M = {5.0: 200.0, 15.0: 650.0}
"""Length of an au by speed, so that the margin of the drawn fields is about the clearance."""
_SAID_LINES = 20
Result = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """What is flown. interrupted_s: when Ctrl-C comes, after the patrol's start by the clock."""

    polygon: int
    speed_m_s: float
    planner: str = "search"
    interrupted_s: float | None = None


FLIGHTS = (
    Flight(polygon=0, speed_m_s=5.0),
    Flight(polygon=1, speed_m_s=15.0),
    Flight(polygon=2, speed_m_s=5.0, interrupted_s=5.0),
    Flight(polygon=3, speed_m_s=15.0, interrupted_s=5.0),
    Flight(polygon=4, speed_m_s=15.0, planner="tsp"),
    Flight(polygon=5, speed_m_s=5.0, planner="lawnmower"),
)


def flown(path: Path, is_asked: bool, first_seed: int) -> list[Result]:
    """What came of the flights in a file, and of those that it lacks if they are asked for."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    results = [json.loads(line) for line in lines]
    done = [Flight(**{key: r[key] for key in Flight.__dataclass_fields__}) for r in results]
    for flight in FLIGHTS if is_asked else ():
        flight = replace(flight, polygon=first_seed + flight.polygon)
        if flight in done:
            continue
        results.append(fly(flight))
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(results[-1]) + "\n")
        print(results[-1], file=sys.stderr, flush=True)
    return results


def fly(flight: Flight) -> Result:
    """Fly once. -> what came of it, distances in m"""
    with tempfile.TemporaryDirectory() as text:
        path, out = Path(text) / "mission.yaml", Path(text) / "run"
        path.write_text(yaml.safe_dump(_mission(flight)), encoding="utf-8")
        child = Spawned(["fly", str(path), "--out", str(out)])
        if flight.interrupted_s is not None:
            wait_until(out, "patrol", flight.interrupted_s, child)
            if child.is_flying:
                os.kill(child.pid, signal.SIGINT)
        status, said = child.end()
        said = said.splitlines()
        try:
            judged = _judged(flight, RunFolder.open(out))
        except (DronemonError, LookupError) as exc:
            sys.exit("\n".join([f"{flight} left no whole record, {exc!r}:", *said[-_SAID_LINES:]]))
        clearance_m = load_mission(path).mission.flight.clearance_m
        result = asdict(flight) | {"status": status, "clearance_m": clearance_m} | judged
        if is_bad(result):
            result["said"] = said[-_SAID_LINES:]
        return result | {"code": code_version()}


def is_bad(result: Result) -> bool:
    """Whether a flight is against what is promised."""
    expected = 0 if result["interrupted_s"] is None else 128 + signal.SIGINT
    return result["status"] != expected or not result["is_landed"] or result["num_bad"] > 0


def _mission(flight: Flight) -> dict[str, Any]:
    border_m, zones_m = _laid(flight)
    return {
        "name": "fields",
        "area": {
            "polygon_m": border_m.tolist(),
            "no_fly": [
                {"name": f"zone {n}", "polygon_m": zone_m.tolist()}
                for n, zone_m in enumerate(zones_m)
            ],
            "sensor_radius_m": SENSOR_RADIUS_AU * _AU_M[flight.speed_m_s],
        },
        "flight": {
            "altitude_m": ALTITUDE_M,
            "cruise_speed_m_s": flight.speed_m_s,
            "horizon_au": HORIZON_AU,
        },
        "camera": {"gimbal": True},
        "targets": [
            {"name": name, "appearance": name, "prior_au": "simulated"}
            for name in ("car-red", "truck-blue")
        ],
        "planner": {"kind": flight.planner},
        "vehicle": {"url": "mock", "speed_up": SPEED_UP},
        "simulation": {"seed": flight.polygon},
        "view": {"live": False},
    }


def _judged(flight: Flight, run: RunFolder) -> Result:
    """Whether the recorded poses, all from arming to the end, are where they may be."""
    (frame,) = (event["frame"] for event in run.events() if event["kind"] == "ready")
    poses_m = np.array([pose["position_ned_m"][:2] for pose in run.poses()])
    track_m = (poses_m - frame["centre_ned_m"])[:, ::-1]
    summary = run.summary()
    return {
        "outcome": summary["outcome"],
        "is_landed": summary["is_landed"],
        **{key: summary.get(key, 0.0) for key in ("speed_p99_m_s", "distance_m")},
        **asdict(how_kept(track_m, *_laid(flight), tolerance=0.0)),
    }


def section(results: list[Result]) -> list[str]:
    """The flights as Markdown; nothing if there are none."""
    if not results:
        return []
    rows = [
        [
            str(r["polygon"]),
            f"{r['planner']}, {r['speed_m_s']:g} m/s" + (", Ctrl-C" if r["interrupted_s"] else ""),
            f"{r['outcome']}, status {r['status']}, {'' if r['is_landed'] else 'not '}landed",
            f"{r['distance_m']:.0f} m, {r['speed_p99_m_s']:.1f} m/s",
            f"{r['num_bad']} of {r['num_legs']}",
            f"{r['zone']:.1f}, {r['border']:.1f}; {r['clearance_m']:.1f}",
        ]
        for r in results
    ]
    header = (
        "polygon|flight|end|patrol, speed p99|astray between poses"
        "|nearest to zone, border; legs keep, m"
    )
    return [
        "## Flights\n",
        f"On the mock at {SPEED_UP:g} times real time, {HORIZON_AU:g} au each (see "
        f"`benchmarks/field_flights.py`); code {', '.join(sorted({r['code'] for r in results}))}."
        "\n",
        *markdown_table(header.split("|"), rows),
    ]


def _laid(flight: Flight) -> tuple[FloatArray, list[FloatArray]]:
    """Corners of border and zones, metres [east, north] of home."""
    arena, au_m = draw_field(flight.polygon), _AU_M[flight.speed_m_s]
    home_au, _ = arena.free.largest_circle()
    border_au, zones_au = corners(arena)
    return au_m * (border_au - home_au), [au_m * (zone_au - home_au) for zone_au in zones_au]
