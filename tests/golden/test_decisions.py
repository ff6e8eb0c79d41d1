"""Planners choose what they chose before, but for the last digits (1e-9 au)."""

from __future__ import annotations

import numpy as np
import pytest
from decisions import episodes, load, waypoints

SAME_AU = 1e-9
"""The last digits of numpy and the C library differ between processors; a decision would by far."""


CASES = [
    pytest.param(
        episode, id=episode[0], marks=[pytest.mark.slow] * (episode[2:] != (10000, "full"))
    )
    for episode in episodes()
]


@pytest.mark.parametrize("episode", CASES)
def test_decisions_are_those_on_file(episode):
    name, *terms = episode
    flown, on_file = np.array(waypoints(*terms)), np.array(load()[name])
    assert flown.shape == on_file.shape
    np.testing.assert_allclose(flown, on_file, rtol=0.0, atol=SAME_AU)
