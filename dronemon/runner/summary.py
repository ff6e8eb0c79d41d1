"""What a flight came to: how it was flown and, where a simulator knows the truth, how well."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch

from dronemon.belief import Belief
from dronemon.belief.grid import evaluation_grid
from dronemon.belief.metrics import area_std, jensen_shannon
from dronemon.events import TruthTold
from dronemon.frames import GeoPoint
from dronemon.mission import Mission, mission_arena
from dronemon.problem import MEASUREMENT_INTERVAL_AU, SENSOR_RADIUS_AU
from dronemon.runner.flight import FlightResult
from dronemon.runner.identity import Identities, identify
from dronemon.runner.last_seen import LastSeen
from dronemon.runner.nearness import KeptOff, kept_off
from dronemon.runner.nearness import in_words as kept_in_words
from dronemon.runner.preparation import mission_kernel
from dronemon.runner.tally import Tally
from dronemon.runner.watch import Watched, in_words, watch
from dronemon.sightings import Sightings
from dronemon.types import FloatArray

_SAME_S = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Flown:
    """How the patrol was flown; None where there is nothing to measure.

    pictures_cut: those that a tilt, or what stands there, kept from showing all of the sensor's
    circle.
    picture_spacing_error: median share by which two pictures are apart more or less than 0.1 au.
    watched: how, of each target by its name.
    """

    distance_m: float
    distance_au: float
    patrol_s: float
    mean_speed_m_s: float | None
    speed_p99_m_s: float | None
    cross_track_p95_m: float | None
    cross_track_p95_au: float | None
    pictures: int
    pictures_due: int
    pictures_cut: int
    picture_spacing_m: float | None
    picture_spacing_error: float | None
    decisions: int
    decision_p50_ms: float | None
    decision_p99_ms: float | None
    watched: Mapping[str, Watched]


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """How well the targets were watched; None where the truth is not known.

    identity_switches: sights that took a target for another than the sight before, None where all
    look different
    """

    unc: float | None = None
    unc_std: float | None = None
    jsd: float | None = None
    min_ob: int | None = None
    identity_switches: int | None = None
    identity_switches_per_h: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What a flight came to; without a patrol there is no more to say than how it ended.

    kept_off: how near it came to each target that it keeps off, by its name
    """

    outcome: str
    is_landed: bool
    last_seen: LastSeen | None
    landing_error_m: float | None
    landing_battery: float | None
    error: str | None
    flown: Flown | None
    score: Score | None
    kept_off: Mapping[str, KeptOff] = field(default_factory=dict)

    def as_json(self) -> dict[str, object]:
        """Every figure by name, as summary.json has them after the outcome."""
        parts = [asdict(part) for part in (self.flown, self.score) if part is not None]
        names = ("is_landed", "landing_error_m", "landing_battery", "error")
        head = {name: getattr(self, name) for name in names}
        if self.last_seen is not None:
            head["last_seen"] = asdict(self.last_seen)
        if self.kept_off:
            head["kept_off"] = {name: asdict(how) for name, how in self.kept_off.items()}
        return head | {name: value for part in parts for name, value in part.items()}


def summarise(
    result: FlightResult,
    *,
    truth: Sequence[TruthTold],
    mission: Mission,
    place_of: Callable[[FloatArray], GeoPoint | None],
) -> Summary:
    """Sum a flight up.

    truth:    where the targets were at each picture, in order; empty where there is no simulator
    place_of: a position in au on the globe, None where that is not known
    """
    tally = result.tally
    known = _identified(tally, truth, mission) if tally else None
    return Summary(
        outcome=result.outcome,
        is_landed=result.is_landed,
        last_seen=result.last_seen,
        landing_error_m=result.landing_error_m,
        landing_battery=result.landing_battery,
        error=str(result.error) if result.error else None,
        flown=flown(tally, mission, place_of) if tally else None,
        score=_score(tally, known, mission) if tally else None,
        kept_off=kept_off(tally.sightings, known and known[0], mission) if tally else {},
    )


def flown(
    tally: Tally, mission: Mission, place_of: Callable[[FloatArray], GeoPoint | None]
) -> Flown:
    """What a tally comes to; see `summarise`."""
    side_m = mission.area.side_m
    spacing_m = np.diff(tally.pictured_m, prepend=0.0)
    due_m = MEASUREMENT_INTERVAL_AU * side_m
    return Flown(
        distance_m=tally.flown_m,
        distance_au=tally.flown_m / side_m,
        patrol_s=tally.duration_s,
        mean_speed_m_s=tally.flown_m / tally.duration_s if tally.duration_s else None,
        speed_p99_m_s=_percentile(tally.speeds_m_s, 99),
        cross_track_p95_m=_percentile(tally.cross_track_m, 95),
        cross_track_p95_au=_percentile(np.array(tally.cross_track_m) / side_m, 95),
        pictures=len(tally.sightings),
        pictures_due=tally.num_pictures_due,
        pictures_cut=sum(m.view_au < SENSOR_RADIUS_AU for m in tally.sightings.since(0)),
        picture_spacing_m=_percentile(spacing_m, 50),
        picture_spacing_error=_percentile(np.abs(spacing_m / due_m - 1.0), 50),
        decisions=len(tally.decision_ms),
        decision_p50_ms=_percentile(tally.decision_ms, 50),
        decision_p99_ms=_percentile(tally.decision_ms, 99),
        watched={
            target.name: watch(tally.sightings, number, mission.seconds_per_au, place_of)
            for number, target in enumerate(mission.targets)
        },
    )


def _identified(
    tally: Tally, truth: Sequence[TruthTold], mission: Mission
) -> tuple[FloatArray, Identities] | None:
    """Where each target was at each measurement, (T, N, 2) au; None where that is not known.

    Where targets look alike, each is the one that it was taken for most often.
    """
    true_au = truth_at(truth, tally.times_s)
    if not tally.sightings or true_au is None:
        return None
    looks = [target.appearance for target in mission.targets]
    identities = identify(tally.sightings, true_au, looks)
    return true_au[:, identities.targets], identities


def _score(tally: Tally, known: tuple[FloatArray, Identities] | None, mission: Mission) -> Score:
    """Unc, JSD and MinOb of the beliefs that the flight had, replayed against the truth."""
    if known is None:
        return Score()
    sightings, (true_au, identities) = tally.sightings, known
    replayed = Sightings(sightings.priors_au, sightings.sensor)
    belief = Belief(replayed, mission_kernel(mission))
    grid = evaluation_grid(mission_arena(mission))
    unc, jsd = [], []
    for measurement, positions in zip(sightings.since(0), true_au, strict=True):
        replayed.add(measurement)
        target_au = torch.tensor(positions)[None]
        now = torch.full_like(target_au[..., 0], measurement.time_au)
        unc.append(area_std(belief.process, target_au, now, grid)[0].numpy())
        query = torch.cat([grid.points_au, now[0, 0].expand(len(grid.points_au), 1)], dim=-1)
        jsd.append(jensen_shannon(belief.process.mean(query), target_au, grid)[0].numpy())
    return Score(
        unc=float(np.mean(unc)),
        unc_std=float(np.std(unc, axis=1).mean()),
        jsd=float(np.mean(jsd)),
        min_ob=min(sightings.num_seen),
        identity_switches=identities.num_switches,
        identity_switches_per_h=(
            identities.num_switches * 3600.0 / tally.duration_s
            if identities.num_switches is not None and tally.duration_s
            else None
        ),
    )


def truth_at(truth: Iterable[TruthTold], times_s: Iterable[float]) -> FloatArray | None:
    """Where the targets were at each of these times. -> (T, N, 2) au, None if one was not told

    Both are in the order in which they came: with a fresh battery vehicle time begins anew.
    """
    told = iter(truth)
    places_au = []
    for time_s in times_s:
        found = next((t.targets_au for t in told if abs(t.time_s - time_s) < _SAME_S), None)
        if found is None:
            return None
        places_au.append(found)
    return np.array(places_au)


def _percentile(values: FloatArray | array[float], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None


def facts(summary: Summary) -> dict[str, str]:
    """What came of the flight, in words, for a table; an error was told when it happened."""
    watched = summary.flown.watched if summary.flown else {}
    told = {name: in_words(how) for name, how in watched.items()}
    return {"outcome": summary.outcome, **told, **how_flown(summary.as_json())}


def how_flown(values: Mapping[str, Any]) -> dict[str, str]:
    """How the flight went, in words. values: of summary.json"""

    def show(name: str, form: str, *keys: str) -> None:
        shown = [values.get(key) for key in keys]
        if all(value is not None for value in shown):
            table[name] = form.format(*shown)

    table: dict[str, str] = {}
    show("landing", "{:.1f} m from home", "landing_error_m")
    show("battery at touch-down", "{:.0%}", "landing_battery")
    show("patrol", "{:.0f} m ({:.1f} au) in {:.0f} s", "distance_m", "distance_au", "patrol_s")
    show("ground speed", "{:.2f} m/s, p99 {:.2f} m/s", "mean_speed_m_s", "speed_p99_m_s")
    show("cross-track error p95", "{:.1f} m ({:.3f} au)", "cross_track_p95_m", "cross_track_p95_au")
    show("pictures", "{} of {}, {:.2f} m apart", "pictures", "pictures_due", "picture_spacing_m")
    if values.get("pictures_cut"):
        show("pictures cut", "{}", "pictures_cut")
    show("decisions", "{}, p99 {:.1f} ms", "decisions", "decision_p99_ms")
    return table | kept_in_words(values.get("kept_off", {}))


_FIGURES = {
    "unc": ("Unc", "{:.3f}: how unsure the beliefs were where the targets truly were, 0 to 1"),
    "unc_std": ("spread of Unc", "{:.3f}: its standard deviation between targets"),
    "jsd": ("JSD", "{:.3f}: how far the beliefs were from the truth, 0 to 0.693 (ln 2)"),
    "identity_switches_per_h": (
        "identity switches",
        "{:.1f} an hour: sights that took a target for another than the sight before",
    ),
    "min_ob": ("MinOb", "{}: pictures of the target that was seen least"),
}


def figures(values: Mapping[str, Any]) -> dict[str, str]:
    """The researcher's figures, each with what it is; none where the truth is not known.

    values: of summary.json
    """
    known = {key: told for key, told in _FIGURES.items() if values.get(key) is not None}
    return {name: form.format(values[key]) for key, (name, form) in known.items()}
