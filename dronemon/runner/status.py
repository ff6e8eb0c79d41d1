"""What a second terminal may know of a run, and the one thing that it may ask of its program."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from dronemon.errors import RecordError
from dronemon.mission import Mission
from dronemon.recorder import IN_FLIGHT, RunFolder
from dronemon.runner.history import GOING_ON, refuse_what_is_over, understanding
from dronemon.runner.relay import BATTERY, CHANGED, REQUEST_FILE, WAITING

_BEGINNINGS = {
    GOING_ON: "gets ready to go on",
    "armed": "takes off",
    "attached": "goes to its place",
    "airborne": "patrols",
    "homecoming": "comes home",
    "control taken": "the pilot flies",
    "control given back": "goes on",
    "disarmed": "is on the ground",
    BATTERY: "waits on the ground for a fresh battery",
    WAITING: "waits on the ground, with a fresh battery, for `dronemon resume`",
    CHANGED: "gets ready to go on",
}
"""What follows an event of a kind."""
_ANSWER_LIMIT_S = 10.0
_LOOK_S = 0.2


def status(folder: RunFolder, mission: Mission) -> dict[str, str]:
    """How far a run is, in words, from its folder alone. Raises RecordError if it is damaged."""
    with understanding(folder):
        return _status(folder, mission)


def _status(folder: RunFolder, mission: Mission) -> dict[str, str]:
    events, seen = list(folder.events()), None
    names = [target.name for target in mission.targets]
    newest_au: dict[str, float | None] = dict.fromkeys(names)
    for seen in folder.observations():
        newest_au |= {name: seen["time_au"] for name in names if seen["targets"][name]["seen"]}
    table = {"program": _program(folder)}
    if folder.is_flown():
        table["doing"] = _doing(_of_the_living(folder, events))
    if events:
        event = events[-1]
        table["last event"] = f"{_ago(event['wall'])}: {event['kind']}: {event['text']}"
    if seen is None:
        return table
    stretch, to_s = seen["stretch"], mission.area.side_m / mission.flight.cruise_speed_m_s
    table["patrol"] = (
        f"{stretch['flown_m'] / mission.area.side_m:.1f} of {mission.horizon_au:g} au, "
        f"{stretch['pictures_due']} pictures"
    )
    level = "unknown" if seen["battery"] is None else f"{seen['battery']:.0%}"
    table["at the last picture"] = f"battery {level}, {seen['battery_needed']:.0%} to get home"
    table["seen before that"] = ", ".join(
        f"{name} never" if at is None else f"{name} {(seen['time_au'] - at) * to_s:.0f} s"
        for name, at in newest_au.items()
    )
    return table


def ask_to_go_on(folder: RunFolder) -> None:
    """Tell a program that waits for it to take off again. Raises RecordError if none does."""
    if not folder.is_flown():
        refuse_what_is_over(folder)
        raise RecordError(
            f"no program flies {folder.path}; go on with it: dronemon fly --resume {folder.path}"
        )
    events = _events_of_the_living(folder)
    doing = _last_word(events) if events else "it has only begun"
    if not events or events[-1]["kind"] != WAITING:
        raise RecordError(f"{folder.path} does not wait for a word: {doing}")
    request, num_before = folder.path / REQUEST_FILE, len(events)
    try:
        try:
            request.touch()
            give_up_s = time.monotonic() + _ANSWER_LIMIT_S
            while time.monotonic() < give_up_s:
                time.sleep(_LOOK_S)
                events = _events_of_the_living(folder)
                if any(event["kind"] == CHANGED for event in events[num_before:]):
                    return
        finally:  # whoever leaves before an answer takes the word back
            request.unlink(missing_ok=True)
    except OSError as exc:
        raise RecordError(f"cannot write {request}: {exc.strerror}") from exc
    raise RecordError(
        f"the program that flies {folder.path} does not say that it goes on, and is asked no more; "
        f"its last word: {_last_word(events)}"
    )


def _program(folder: RunFolder) -> str:
    outcome = folder.summary().get("outcome")
    if folder.is_flown():
        return "runs"
    if outcome == IN_FLIGHT and folder.rewatched() is not None:
        return "was killed, or crashed; look at the pictures again: dronemon rewatch"
    if outcome == IN_FLIGHT:
        return f"was killed, or crashed; go on: dronemon fly --resume {folder.path}"
    return f"ended: {outcome}"


def _events_of_the_living(folder: RunFolder) -> list[dict[str, Any]]:
    with understanding(folder):
        return _of_the_living(folder, folder.events())


def _last_word(events: Sequence[Mapping[str, Any]]) -> str:
    return f"{events[-1]['kind']}: {events[-1]['text']}"


def _of_the_living(folder: RunFolder, events: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Events of the program that flies a run, without those of programs that flew it before."""
    return list(events)[folder.summary().get("events_before", 0) :]


def _doing(events: Sequence[Mapping[str, Any]]) -> str:
    """What a program that flies does, by the last event that begins something."""
    begun = [event["kind"] for event in events if event["kind"] in _BEGINNINGS]
    return _BEGINNINGS[begun[-1]] if begun else "gets ready"


def _ago(wall: str) -> str:
    passed_s = (datetime.now(UTC) - datetime.fromisoformat(wall)).total_seconds()
    return f"{max(passed_s, 0.0):.0f} s ago"
