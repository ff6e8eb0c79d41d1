"""What an autopilot says in words: chunks of STATUSTEXT to texts that a terminal can show."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from dronemon.vehicle.link import StatusText

_KEPT = 100
_CHUNK_BYTES = 50
_CHUNK_WAIT_S = 1.0
_REPEATED_S = 10.0
_SEVERITIES = range(8)
_LOST = "…"


class StatusTexts:
    """Puts the chunks of STATUSTEXT together; control characters are left out.

    A chunk that is not full is a text's last. PX4 ends its texts with a tab, and sends nothing more
    after a chunk that the text just fills.

    num_heard: texts so far, each repetition too.

    Source: MAVLink common message set, STATUSTEXT.
    """

    def __init__(self) -> None:
        self.num_heard = 0
        self._heard: deque[StatusText] = deque(maxlen=_KEPT)
        self._to_say: deque[StatusText] = deque(maxlen=_KEPT)
        self._heard_s: dict[StatusText, float] = {}
        self._chunks: list[str] = []  # of the text under way
        self._severity = self._number = self._next_chunk = 0
        self._since_s = 0.0
        self._last: tuple[Any, ...] = ()

    def take(self, fields: dict[str, Any], now_s: float) -> None:
        """Take one chunk; MAVLink 1 has no `id` and `chunk_seq`. Raises ValueError."""
        severity, number, sequence = (
            fields["severity"],
            fields.get("id", 0),
            fields.get("chunk_seq", 0),
        )
        if severity not in _SEVERITIES:
            raise ValueError(f"severity {severity}")
        chunk = str(fields["text"]).split("\0", 1)[0]
        last, self._last = self._last, (number, sequence, chunk)
        if number and last == self._last:
            return  # it came twice
        if number != self._number or sequence < self._next_chunk:
            self._finish(_LOST)
        if not self._chunks:
            self._severity, self._number, self._since_s = severity, number, now_s
        self._chunks += [chunk] if sequence == self._next_chunk else [_LOST, chunk]
        self._next_chunk = sequence + 1
        if len(chunk.encode()) < _CHUNK_BYTES or chunk.endswith("\t"):
            self._finish()

    def said(self, now_s: float) -> list[StatusText]:
        """The texts since the last call, without those that were heard within 10 s before."""
        self._finish_late(now_s)
        said = list(self._to_say)
        self._to_say.clear()
        return said

    def since(self, num_heard: int, now_s: float) -> list[str]:
        """What was said after the first `num_heard` texts, each once."""
        self._finish_late(now_s)
        texts = [said.text for said in self._heard]
        return list(dict.fromkeys(texts[max(len(texts) - self.num_heard + num_heard, 0) :]))

    def _finish_late(self, now_s: float) -> None:
        """Finish a text whose end does not come."""
        if not 0.0 <= now_s - self._since_s < _CHUNK_WAIT_S:
            self._finish(_LOST)

    def _finish(self, mark: str = "") -> None:
        text = "".join(c for c in "".join(self._chunks) if c.isprintable()).rstrip() + mark
        if self._chunks and text:
            said = StatusText(severity=self._severity, text=text)
            self.num_heard += 1
            self._heard.append(said)
            if not 0.0 <= self._since_s - self._heard_s.get(said, -math.inf) < _REPEATED_S:
                self._to_say.append(said)
                self._heard_s = {s: t for s, t in self._heard_s.items() if s in self._heard}
            self._heard_s[said] = self._since_s
        self._chunks, self._next_chunk = [], 0
