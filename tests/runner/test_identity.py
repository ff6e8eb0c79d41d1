"""Which of several that look alike each target of a log truly was."""

from __future__ import annotations

import numpy as np

from dronemon.runner.identity import identify
from dronemon.sightings import Sightings
from dronemon.types import Measurement

TRUE_AU = np.tile(np.array([[0.2, 0.2], [0.5, 0.5], [0.8, 0.8]]), (6, 1, 1))


def log(sights: list[dict[int, int]], priors_au: np.ndarray) -> Sightings:
    """sights: of each picture, target -> true one at whose place it was seen"""
    sightings = Sightings(priors_au)
    for step, own in enumerate(sights):
        seen, target_au = np.zeros(3, np.bool_), np.full((3, 2), np.nan)
        for target, who in own.items():
            seen[target], target_au[target] = True, TRUE_AU[step, who] + 0.001
        sightings.add(
            Measurement(time_au=0.1 * step, agent_au=np.zeros(2), seen=seen, target_au=target_au)
        )
    return sightings


def test_targets_are_who_they_were_most_often_and_changes_count():
    sights = [{0: 2}, {0: 2}, {0: 1}, {0: 2}, {1: 1}, {}]
    found = identify(log(sights, np.full((3, 2), np.nan)), TRUE_AU, ["zebra"] * 3)
    np.testing.assert_array_equal(found.targets, [2, 1, 0])
    assert found.num_switches == 2


def test_who_was_known_before_take_off_is_switched_by_a_first_sight_of_another():
    priors_au = np.array([[0.2, 0.2], [0.5, 0.5], [0.8, 0.8]])
    found = identify(log([{0: 1}, {0: 1}], priors_au), TRUE_AU[:2], ["zebra"] * 3)
    assert found.num_switches == 1


def test_other_looks_are_never_taken_and_nothing_is_counted_where_none_are_alike():
    nobody = np.full((3, 2), np.nan)
    found = identify(log([{0: 1}], nobody), TRUE_AU[:1], ["cow", "fox", "zebra"])
    np.testing.assert_array_equal(found.targets, [0, 1, 2])
    assert found.num_switches is None
    found = identify(log([{0: 2}, {1: 0}], nobody), TRUE_AU[:2], ["cow", "cow", "zebra"])
    assert set(found.targets.tolist()[:2]) == {0, 1}
    assert found.targets[2] == 2
