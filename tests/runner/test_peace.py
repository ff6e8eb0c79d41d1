"""Where targets are believed to be, and how near a drone came to them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.mission import Mission, load_mission
from dronemon.problem import WINDOW_AU
from dronemon.runner.nearness import in_words, kept_off
from dronemon.runner.peace import believed_au
from dronemon.runner.summary import how_flown
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Measurement

NOWHERE = np.full((1, 2), np.nan)


def log_of(
    sights: dict[float, tuple[float, float]],
    *,
    until_au: float = 0.0,
    agent_au: tuple[float, float] = (0.5, 0.5),
    priors_au: FloatArray = NOWHERE,
) -> Sightings:
    """A measurement every 0.1 au, some of which saw the one target."""
    sightings = Sightings(priors_au)
    for number in range(1, round(10 * max([until_au, *sights])) + 1):
        place = sights.get(number / 10)
        sightings.add(
            Measurement(
                time_au=number / 10,
                agent_au=np.array(agent_au),
                seen=np.array([place is not None]),
                target_au=np.array([place or (math.nan, math.nan)]),
            )
        )
    return sightings


def test_who_was_never_seen_is_nowhere():
    assert believed_au(Sightings(NOWHERE), 0, 1.0) is None


def test_a_prior_counts_as_seen():
    assert believed_au(Sightings(np.array([[0.2, 0.3]])), 0, 1.0) == pytest.approx([0.2, 0.3])


velocities = st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))


@settings(max_examples=40)
@given(velocities, st.floats(0.0, 10.0))
def test_it_goes_on_as_it_went_until_it_may_be_anywhere_in_view(velocity, since_au):
    at = {t: (0.5 + velocity[0] * t, 0.5 + velocity[1] * t) for t in (0.7, 0.8, 0.9, 1.0)}
    place_au = believed_au(log_of(at), 0, 1.0 + since_au)
    way_au = math.hypot(*velocity) * since_au
    if way_au > 0.1 + 1e-9 or since_au > WINDOW_AU:
        assert place_au is None
    elif way_au < 0.1 - 1e-9:
        there = [at[1.0][0] + velocity[0] * since_au, at[1.0][1] + velocity[1] * since_au]
        assert place_au == pytest.approx(there)


def test_where_it_went_long_ago_says_how_fast_but_not_where_to():
    seen_au = log_of({0.1: (0.2, 0.5), 1.1: (0.3, 0.5)})
    assert believed_au(seen_au, 0, 1.9) == pytest.approx([0.3, 0.5])
    assert believed_au(seen_au, 0, 2.2) is None


@pytest.fixture
def mission(tmp_path: Path) -> Mission:
    path = tmp_path / "m.yaml"
    path.write_text(
        """
area: {side_m: 200}
flight: {altitude_m: 45, cruise_speed_m_s: 5, horizon_au: 5}
targets: [{name: Bella, appearance: cow, keep_off: {distance_m: 10, below_m: 60}}]
"""
    )
    return load_mission(path).mission


def at_m(*aways_m: float) -> dict[float, tuple[float, float]]:
    """Sights so far east of the drone, one after the other; NaN where it is not seen."""
    told = {(n + 1) / 10: (0.5 + away_m / 200, 0.5) for n, away_m in enumerate(aways_m)}
    return {time_au: place for time_au, place in told.items() if not math.isnan(place[0])}


@pytest.mark.parametrize(
    ("aways_m", "nearest_m", "times", "nearer_s"),
    [
        ((math.nan, 15.0, 12.0), 12.0, 0, 0.0),
        ((15.0, 8.0, 15.0), 8.0, 1, 4.0),  # a picture every 4 s
        ((15.0, 8.0, 7.0, 15.0, 9.0, 15.0), 7.0, 2, 12.0),
        ((8.0, 15.0), 8.0, 1, 2.0),
        ((15.0, 8.0), 8.0, 1, 2.0),
        ((8.0, math.nan, 9.0, 11.0), 8.0, 2, 6.0),
    ],
)
def test_nearer_pictures_in_a_row_count_once(mission, aways_m, nearest_m, times, nearer_s):
    (how,) = kept_off(log_of(at_m(*aways_m)), None, mission).values()
    assert how.seen.nearest_m == pytest.approx(nearest_m)
    assert how.seen.times_nearer == times
    assert how.seen.nearer_s == pytest.approx(nearer_s)
    assert how.true is None


def test_who_was_never_seen_was_near_nobody_but_in_truth(mission):
    true_au = np.array([[[0.54, 0.5]], [[0.52, 0.5]]])
    (how,) = kept_off(log_of({}, until_au=0.2), true_au, mission).values()
    assert how.seen.nearest_m is None
    assert how.true is not None
    assert how.true.nearest_m == pytest.approx(4.0)


def test_no_pause_is_time_near_it(mission):
    log = log_of(at_m(15.0, 8.0))
    after_pause = log_of(at_m(*[math.nan] * 89, 15.0)).since(89)[0]
    log.add(after_pause)
    (how,) = kept_off(log, None, mission).values()
    assert how.seen.nearer_s == pytest.approx(2.0 + 4.0), "of half a minute and more"


def test_a_patrol_of_no_picture_has_nothing_to_tell(mission):
    (how,) = kept_off(Sightings(NOWHERE), None, mission).values()
    assert (how.seen.nearest_m, how.seen.times_nearer, how.seen.nearer_s) == (None, 0, 0.0)


def test_words():
    seen = {"nearest_m": 8.4, "times_nearer": 2, "nearer_s": 12.0}
    far = {"nearest_m": 12.3, "times_nearer": 0, "nearer_s": 0.0}
    never = {"nearest_m": None, "times_nearer": 0, "nearer_s": 0.0}
    kept = {
        "A": {"distance_m": 10.0, "seen": seen, "true": None},
        "B": {"distance_m": 10.0, "seen": far, "true": seen},
        "C": {"distance_m": 10.0, "seen": never, "true": None},
        "D": {"distance_m": 10.0, "seen": never, "true": seen},
    }
    nearest = "m at the nearest in its pictures"
    assert in_words(kept) == {
        "kept off A": f"8 {nearest}; nearer than 10 m 2 times, for 12 s",
        "kept off B": f"12 {nearest} (truly 8 m); never seen nearer than 10 m",
        "kept off C": "never seen",
        "kept off D": "never seen (truly 8 m)",
    }
    assert how_flown({"kept_off": kept}) == in_words(kept)
