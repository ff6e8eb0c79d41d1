"""One log of what was seen: its widths, its cursors, its windows, what it refuses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.errors import BeliefError
from dronemon.sightings import Sight, Sightings
from dronemon.types import FloatArray, Measurement

NOBODY = np.empty((0, 2))


def measurement(time_au: float, *places_au: tuple[float, float] | None) -> Measurement:
    """What was said of each target: its place where seen."""
    nowhere = (math.nan, math.nan)
    return Measurement(
        time_au=time_au,
        agent_au=np.array([0.5, 0.25]),
        seen=np.array([place is not None for place in places_au], dtype=np.bool_),
        target_au=np.array([place or nowhere for place in places_au]).reshape(-1, 2),
    )


def priors(*places_au: tuple[float, float] | None) -> FloatArray:
    return np.array([place or (math.nan, math.nan) for place in places_au])


def test_everything_is_read_off_the_log() -> None:
    log = Sightings(priors((0.1, 0.2), None))
    assert (len(log), log.time_au, log.num_targets) == (0, 0.0, 2)
    first, second = measurement(0.1, None, (0.5, 0.3)), measurement(0.2, (0.5, 0.2), (0.5, 0.31))
    log.add(first)
    log.add(second)
    assert log.since(1) == [second]
    assert log.since(2) == []
    assert log.time_au == 0.2
    assert log.num_seen == [1, 2]
    np.testing.assert_array_equal(log.last_seen_au, [0.2, 0.2])
    np.testing.assert_array_equal(log.last_places_au, [[0.5, 0.2], [0.5, 0.31]])
    assert log.sights(0, before_au=0.2, most=6) == [Sight(0.0, 0.1, 0.2)]
    assert log.sights(1, before_au=math.inf, most=1) == [Sight(0.2, 0.5, 0.31)]
    assert log.sights(7, before_au=math.inf, most=1) == []


def test_never_seen_is_never_and_nowhere() -> None:
    log = Sightings(priors(None))
    assert log.last_seen_au.tolist() == [-math.inf]
    assert np.isnan(log.last_places_au).all()
    assert Sightings(NOBODY).last_places_au.shape == (0, 2)


def test_a_target_that_joins_was_not_seen_before() -> None:
    log = Sightings(NOBODY)
    log.add(measurement(0.1))
    log.add(measurement(0.2, (0.5, 0.3)))
    points, values, mask = log.window(6.0)
    np.testing.assert_array_equal(points[0, 1:], [[0.5, 0.25, 0.1], [0.5, 0.3, 0.2]])
    assert values[0].tolist() == [0.0, 0.0, 1.0]
    assert mask[0].tolist() == [False, True, True]
    imagined = log.window(6.0, num_targets=2)
    np.testing.assert_array_equal(imagined.points[1, 1:], [[0.5, 0.25, 0.1], [0.5, 0.25, 0.2]])
    assert not imagined.values[1].any()


def test_a_picture_that_showed_too_little_says_nothing_of_targets_unseen() -> None:
    log = Sightings(NOBODY)
    for step, view_au in enumerate((0.1, 0.06, 0.04), start=1):
        log.add(replace(measurement(0.1 * step, (0.5, 0.3), None), view_au=view_au))
    points, values, mask = log.window(6.0)
    assert mask[:, 1:].tolist() == [[True, True, True], [True, True, False]]
    np.testing.assert_array_equal(points[0, 3], [0.5, 0.3, 0.1 * 3])
    assert values[0, 3] == 1.0


@settings(max_examples=30)
@given(gaps_au=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40), span_au=st.floats(0.05, 3.0))
def test_window_holds_what_is_younger_than_its_span(gaps_au: list[float], span_au: float) -> None:
    times_au = np.cumsum(gaps_au)
    log = Sightings(priors((0.5, 0.5), None))
    for time_au in times_au:
        log.add(measurement(float(time_au), None, None))
    points, _, mask = log.window(span_au)
    kept = times_au[times_au[-1] - times_au < span_au]
    np.testing.assert_array_equal(points[1, mask[1], 2], kept)
    prior = [0.0] if times_au[-1] < span_au else []
    np.testing.assert_array_equal(points[0, mask[0], 2], [*prior, *kept])


def test_what_cannot_be_is_refused() -> None:
    log = Sightings(priors(None, None))
    log.add(measurement(0.2, None, None))
    with pytest.raises(BeliefError, match="in the order of their time"):
        log.add(measurement(0.1, None, None))
    with pytest.raises(BeliefError, match=r"measurement of 1 targets.* where 2 are known"):
        log.add(measurement(0.3, None))
    with pytest.raises(BeliefError, match="not finite"):
        log.add(measurement(0.3, (math.nan, 0.5), None))
    assert len(log) == 1
