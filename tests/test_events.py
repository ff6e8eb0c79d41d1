"""Whoever watches a flight is told of it, and fails without holding it up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import NoReturn

from dronemon.events import Audience, Event, EventStream


def fails(_: Event) -> NoReturn:
    raise SystemExit(1)


def test_a_watcher_that_fails_takes_nothing_from_the_others() -> None:
    heard, recorded, event = list[Event](), list[Event](), Event()
    broken = SimpleNamespace(take=fails, lost="")
    audience = Audience((broken, SimpleNamespace(take=heard.append, lost="")))
    stream = EventStream(SimpleNamespace(take=recorded.append), audience, SimpleNamespace())
    stream.emit(event)
    assert heard == recorded == [event]
    assert audience.losses() == ["1 events that a watcher failed at"]


def test_what_was_lost_is_told_once() -> None:
    watcher = SimpleNamespace(take=fails, lost="")
    audience = Audience((watcher,))
    assert audience.losses() == []
    watcher.lost = "3 crops"
    assert (audience.losses(), audience.losses()) == (["3 crops"], [])
    watcher.lost = "4 crops"
    assert audience.losses() == ["4 crops"]
