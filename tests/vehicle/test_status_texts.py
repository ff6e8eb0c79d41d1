"""What the autopilot says in words, from the fields of STATUSTEXT."""

from __future__ import annotations

import pytest

from dronemon.vehicle import StatusText
from dronemon.vehicle.status_texts import StatusTexts

LONG = "Preflight Fail: the heading estimate is not stable, wait or move the vehicle away from iron"


def chunks(text, number, severity=4):
    """STATUSTEXT's fields as PX4 cuts a text."""
    pieces = [text[i : i + 50] for i in range(0, len(text), 50)]
    return [
        {"severity": severity, "text": piece, "id": number, "chunk_seq": i}
        for i, piece in enumerate(pieces)
    ]


def say(texts, *messages, at_s=0.0):
    for fields in messages:
        texts.take(fields, at_s)
    return [said.text for said in texts.said(at_s)]


def test_long_text_is_put_together():
    texts = StatusTexts()
    for fields in chunks(LONG + "\t", number=7, severity=2):
        texts.take(fields, 0.0)
    assert texts.said(0.0) == [StatusText(severity=2, text=LONG)]
    assert texts.said(0.0) == []


def test_short_texts_lose_their_padding_only():
    padded = [{"severity": 6, "text": "Ready for takeoff!\t\0\0\0"}, *chunks("Armed", number=3)]
    assert say(StatusTexts(), *padded) == ["Ready for takeoff!", "Armed"]


@pytest.mark.parametrize(
    ("lost", "text"),
    [(0, f"…{LONG[50:]}"), (1, f"{LONG[:50]}…")],
)
def test_a_lost_chunk_is_marked(lost, text):
    heard = chunks(LONG, number=7)
    del heard[lost]
    assert say(StatusTexts(), *heard, *chunks("Landing detected", number=8)) == [
        text,
        "Landing detected",
    ]


def test_a_chunk_lost_in_the_middle_is_marked():
    first, _, last = chunks(2 * LONG[:50] + "end", number=7)
    assert say(StatusTexts(), first, last) == [f"{LONG[:50]}…end"]


def test_a_text_without_its_end_waits_a_second_of_vehicle_time():
    texts = StatusTexts()
    assert say(texts, chunks(LONG, number=7)[0], at_s=10.0) == []
    assert texts.said(10.9) == []
    assert [said.text for said in texts.said(11.0)] == [f"{LONG[:50]}…"]


def test_a_text_that_fills_its_chunk_ends_with_px4s_tab():
    assert say(StatusTexts(), *chunks(LONG[:49] + "\t", number=7)) == [LONG[:49]]


def test_control_characters_do_not_reach_a_terminal():
    evil = {"severity": 4, "text": "\x1b[31mArm\x07ed\n\u202e \x9b0m"}
    assert say(StatusTexts(), evil) == ["[31mArmed 0m"]


def test_chunks_that_come_twice_make_one_text():
    twice = [fields for fields in chunks(LONG, number=7) for _ in range(2)]
    assert say(StatusTexts(), *twice) == [LONG]


def test_a_text_that_is_repeated_within_ten_seconds_is_told_once_and_found_again():
    texts, armed = StatusTexts(), chunks("Armed", number=0)
    assert say(texts, *armed, at_s=1.0) == ["Armed"]
    num_heard = texts.num_heard
    assert say(texts, *armed, *chunks("Landed", number=0), at_s=9.0) == ["Landed"]
    assert texts.since(num_heard, 9.0) == ["Armed", "Landed"]
    assert say(texts, *armed, at_s=19.0) == ["Armed"]


def test_a_severity_that_is_none_is_refused():
    with pytest.raises(ValueError, match="severity 9"):
        say(StatusTexts(), {"severity": 9, "text": "Armed"})
