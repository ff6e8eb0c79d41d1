from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.world import measure, sample_leg
from dronemon.world.sensing import sense


def test_measurements_fall_every_tenth_of_a_straight_flight() -> None:
    leg = sample_leg(np.array([0.0, 0.5]), np.array([0.35, 0.5]), 0.0)
    np.testing.assert_allclose(leg.positions_au, [[0.1, 0.5], [0.2, 0.5], [0.3, 0.5]])
    np.testing.assert_allclose(leg.offsets_au, [0.1, 0.2, 0.3])
    assert leg.residual_au == pytest.approx(0.05)


def test_residual_is_carried_over_short_legs() -> None:
    corners = np.array([[0.0, 0.0], [0.04, 0.0], [0.04, 0.03], [0.1, 0.03]])
    residual, found = 0.0, []
    for start, end in pairwise(corners):
        leg = sample_leg(start, end, residual)
        residual = leg.residual_au
        found += leg.positions_au.tolist()
    np.testing.assert_allclose(found, [[0.07, 0.03]])  # 0.04 + 0.03 + 0.03 flown
    assert residual == pytest.approx(0.03)


def test_legs_of_one_interval_have_one_measurement_each() -> None:
    here, residual = np.array([0.1, 0.1]), 0.0
    for step in range(300):
        angle = 0.7 * step
        end = here + 0.1 * np.array([np.cos(angle), np.sin(angle)])
        leg = sample_leg(here, end, residual)
        assert len(leg.positions_au) == 1
        np.testing.assert_allclose(leg.positions_au[0], end, atol=1e-9)
        here, residual = end, leg.residual_au


@settings(max_examples=100)
@given(lengths=st.lists(st.floats(1e-6, 0.5), min_size=1, max_size=40))
def test_number_of_measurements_depends_on_length_alone(lengths: list[float]) -> None:
    residual, count, x = 0.0, 0, 0.0
    for length in lengths:
        leg = sample_leg(np.array([x, 0.0]), np.array([x + length, 0.0]), residual)
        residual, count, x = leg.residual_au, count + len(leg.positions_au), x + length
    assert 0.0 <= residual < 0.1
    assert count * 0.1 + residual == pytest.approx(x, abs=1e-6)


def test_field_of_view_excludes_its_rim() -> None:
    agent = np.array([0.5, 0.5])
    targets = np.array([[0.5, 0.5], [0.5, 0.5999], [0.5, 0.6001], [0.43, 0.43], [0.42, 0.42]])
    np.testing.assert_array_equal(sense(agent, targets), [True, True, False, True, False])
    assert not sense(np.zeros(2), np.array([[0.1, 0.0]]))[0]  # exactly 0.1


def test_targets_at_the_border_are_seen_like_any() -> None:
    assert sense(np.array([0.05, 1.0]), np.array([[0.0, 1.0], [1.0, 0.0]])).tolist() == [
        True,
        False,
    ]


def test_measurement_tells_no_position_of_what_was_not_seen() -> None:
    measurement = measure(0.3, np.array([0.2, 0.2]), np.array([[0.25, 0.2], [0.9, 0.9]]))
    assert measurement.seen.tolist() == [True, False]
    np.testing.assert_array_equal(measurement.target_au, [[0.25, 0.2], [np.nan, np.nan]])
