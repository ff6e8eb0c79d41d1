"""Eyes that err: as often and as far as they are said to, and what cannot be said of them."""

from __future__ import annotations

import numpy as np
import pytest

from dronemon.arena import ARENA
from dronemon.errors import OptionError
from dronemon.sensor import PERFECT, Sensor
from dronemon.types import BoolArray, FloatArray
from dronemon.world import measure, misread

AGENT_AU = np.array([0.5, 0.5])
TARGETS_AU = np.array([[0.55, 0.5], [0.5, 0.45], [0.9, 0.9], [0.1, 0.2]])


def told(sensor: Sensor, count: int = 4000) -> tuple[BoolArray, FloatArray]:
    """What is seen of two targets in view and two that are not. -> (count, 4), (count, 4, 2)."""
    rng = np.random.default_rng(0)
    truth = measure(0.1, AGENT_AU, TARGETS_AU)
    every = [misread(truth, sensor, ARENA, rng) for _ in range(count)]
    return np.stack([m.seen for m in every]), np.stack([m.target_au for m in every])


def test_a_perfect_eye_tells_the_truth_and_draws_nothing() -> None:
    truth, rng = measure(0.1, AGENT_AU, TARGETS_AU), np.random.default_rng(0)
    assert misread(truth, PERFECT, ARENA, rng) is truth
    assert rng.random() == np.random.default_rng(0).random()


def test_misses_are_as_frequent_as_said() -> None:
    seen, places = told(Sensor(miss=0.2))
    np.testing.assert_allclose(seen.mean(axis=0), [0.8, 0.8, 0.0, 0.0], atol=0.02)
    np.testing.assert_array_equal(
        places[seen[:, 0], 0], np.tile(TARGETS_AU[0], (seen[:, 0].sum(), 1))
    )
    assert np.isnan(places[~seen]).all()


def test_false_alarms_are_of_whom_is_not_seen_and_within_view() -> None:
    seen, places = told(Sensor(false_alarms=0.3))
    assert seen[:, :2].all()
    assert seen[:, 2:].sum() / len(seen) == pytest.approx(0.3, abs=0.03)
    distance = np.linalg.norm(places[seen] - AGENT_AU, axis=-1)
    assert distance.max() < 0.1
    alarms = distance[np.argwhere(seen)[:, 1] >= 2]
    assert np.median(alarms) == pytest.approx(0.1 / np.sqrt(2.0), abs=0.004)  # even over the disc


def test_places_err_as_far_as_said_and_identities_as_often() -> None:
    seen, places = told(Sensor(position_au=0.01))
    assert seen[:, :2].all()
    assert (places[:, 0] - TARGETS_AU[0]).std(axis=0) == pytest.approx([0.01, 0.01], rel=0.05)
    seen, places = told(Sensor(confusion=0.3))
    right = (places[:, :2] == TARGETS_AU[:2]).all(axis=-1)
    taken = (places[:, 2:, None] == TARGETS_AU[:2]).all(axis=-1).any(axis=-1)
    # Of the first, one in ten is lost where the second is taken for it.
    assert right.mean(axis=0) == pytest.approx([0.63, 0.7], abs=0.02)
    assert taken.any(axis=0).all()
    assert (seen.sum(axis=1) <= 2).all()


@pytest.mark.parametrize(
    "sensor",
    [PERFECT, Sensor(miss=0.12345678), Sensor(false_alarms=0.05, position_au=0.01)],
)
def test_what_a_sensor_is_called_is_read_again(sensor: Sensor) -> None:
    assert Sensor.parse(str(sensor)) == sensor


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("good", "'good' of 'good' is no error"),
        ("miss", "'miss' of"),
        ("miss=", "'miss=' of"),
        ("miss=nan", "'miss=nan' of"),
        ("miss=0.1+miss=0.2", "'miss=0.2' of"),
        ("miss=1.5", "miss=1.5 is not 0 to 0.9"),
        ("position_au=-0.1", "position_au=-0.1 is not 0 to 0.05"),
    ],
)
def test_what_is_no_sensor_is_refused(text: str, what: str) -> None:
    with pytest.raises(OptionError, match=what):
        Sensor.parse(text)
