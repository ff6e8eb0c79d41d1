"""How a detector errs is counted as a person would."""

from __future__ import annotations

import numpy as np
import pytest

from dronemon.errors import OptionError
from dronemon.types import Detection
from dronemon.vision.scoring import Score


def find(appearance: str, u_px: float, v_px: float = 0.0) -> Detection:
    return Detection(appearance=appearance, pixel_px=(u_px, v_px), score=1.0)


def is_in_view(find: Detection) -> bool:
    return find.pixel_px[0] < 100.0


def score(*pictures: tuple[list[Detection], list[Detection]], within_m: float = 1.0) -> Score:
    counted = Score(["cow", "fox"], within_m)
    for labels, finds in pictures:
        counted.add(labels, finds, 0.1, is_in_view)
    return counted


def test_misses_false_alarms_and_mistakes_are_counted() -> None:
    counted = score(
        ([find("cow", 10), find("fox", 50)], [find("cow", 12), find("cow", 51)]),
        ([find("cow", 10)], [find("fox", 80)]),
        ([], [find("cow", 30)]),
        ([find("fox", 10)], []),
    )
    assert counted.labelled == {"cow": 2, "fox": 2}
    assert counted.taken_for == {"cow": {"cow": 1}, "fox": {"cow": 1}}
    sensor = counted.sensor(side_m=10.0)
    assert (sensor.miss, sensor.false_alarms, sensor.confusion) == (0.5, 0.5, 0.5)
    assert sensor.position_au == pytest.approx(np.sqrt((0.2**2 + 0.1**2) / 4.0) / 10.0)
    assert counted.confusion() == {}, "of the fox it cannot be said: it is never found as itself"


def test_a_find_is_of_one_label_only_and_as_many_as_can_be_are_found() -> None:
    twice = score(([find("cow", 10)], [find("cow", 9), find("cow", 11)]))
    assert (twice.num_found, twice.false_alarms) == (1, 1)
    # The nearest label of the middle one is the right one, which then would find none.
    between = score(([find("cow", 10), find("cow", 22)], [find("cow", 17), find("cow", 25)]))
    assert (between.num_found, between.false_alarms) == (2, 0)


def test_the_find_of_the_right_appearance_is_taken_of_two() -> None:
    counted = score(([find("cow", 10)], [find("fox", 10), find("cow", 12)]))
    assert counted.taken_for["cow"] == {"cow": 1}
    assert counted.false_alarms == 1


def test_what_lies_out_of_view_counts_for_nothing_but_its_pair() -> None:
    beyond = score(([find("cow", 101), find("cow", 150)], [find("cow", 99), find("cow", 180)]))
    assert (beyond.num_labelled, beyond.false_alarms) == (0, 0)
    within = score(([find("cow", 99)], [find("cow", 101)]))
    assert (within.num_labelled, within.num_found, within.false_alarms) == (1, 1, 0)


def test_shares_of_what_is_taken_for_another() -> None:
    seen = [([find("cow", 10)], [find(name, 10)]) for name in ("cow", "cow", "cow", "fox")]
    assert score(*seen).confusion() == {"cow": {"fox": 0.25}}


def test_errors_beyond_what_planners_can_be_told_are_refused() -> None:
    with pytest.raises(OptionError, match=r"miss=1 is not 0 to 0\.9"):
        score(([find("cow", 10)], [])).sensor(side_m=10.0)
