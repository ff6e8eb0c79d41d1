"""A flight on a vehicle in memory, watched by the guard's table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from flights import (
    Flight,
    flown,
)

from dronemon import guard
from dronemon.guard import TABLE, Advice, Reason, Situation
from dronemon.runner import supervisor


@pytest.fixture
def prepare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Flight]:
    """Makes a flight whose `reasons` are those that the guard gave last."""
    reasons: set[Reason] = set()

    def advise(situation: Situation) -> Advice:
        flown.add(TABLE.index(guard.deciding_row(situation)))
        advice = guard.advise(situation)
        reasons.add(advice.reason)
        return advice

    def make() -> Flight:
        reasons.clear()
        return Flight(tmp_path / "small.yaml", reasons)

    monkeypatch.setattr(supervisor, "advise", advise)
    return make


@pytest.fixture
def flight(prepare: Callable[[], Flight]) -> Flight:
    return prepare()
