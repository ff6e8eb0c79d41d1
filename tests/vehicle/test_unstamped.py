"""What is believed of values whose messages have no stamp."""

from __future__ import annotations

import pytest

from dronemon.vehicle.unstamped import Unstamped


@pytest.mark.parametrize("late_s", [0.5, 1.5, 6.5, 8.5, 9.5])
@pytest.mark.parametrize("lost_s", [(), (103,), (103, 104), (101, 104, 107)])
def test_late_copies_of_what_was_are_not_believed_though_fresh_messages_are_lost(late_s, lost_s):
    says = Unstamped("disarmed")
    heard = []
    for at_s in range(80, 130):
        value = "armed" if at_s >= 100 else "disarmed"
        heard += [] if at_s in lost_s else [(at_s, value)]
        heard += [(at_s + late_s, value)]
    for at_s, value in sorted(heard):
        says.take(value, at_s)
        assert (says.value == "armed") == (at_s >= 100), (at_s, value)


def test_what_was_left_comes_back_once_nothing_has_contradicted_it_for_a_while():
    says = Unstamped("hold")
    says.take("offboard", 100.0)
    believed = [(says.take("hold", at_s), says.doubted)[1] for at_s in (103.0, 104.0, 105.0)]
    assert believed == ["hold"] * 3
    assert says.take("hold", 106.0)
    assert (says.value, says.doubted) == ("hold", None)


def test_what_was_left_long_ago_comes_back_at_once():
    says = Unstamped("hold")
    says.take("offboard", 100.0)
    assert says.take("hold", 110.0)


@pytest.mark.parametrize(
    ("said", "is_believed"),
    [("b", False), ("bb", True), ("bab", False), ("bc", True), ("db", False), ("d", True)],
)
def test_what_is_grave_is_believed_when_two_in_a_row_are(said, is_believed):
    says = Unstamped("a", lambda _, after: after in "bc")
    for at_s, value in enumerate(said):
        says.take(value, 100.0 + at_s)
    assert (says.value == said[-1]) == is_believed


def test_time_that_begins_anew_doubts_nothing():
    says = Unstamped("hold")
    says.take("offboard", 100.0)
    says.take("hold", 101.0)
    says.forget()
    assert says.doubted is None
    assert says.take("hold", 1.0)
