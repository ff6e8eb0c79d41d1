"""How targets were watched, in figures and in words."""

from __future__ import annotations

import numpy as np
import pytest

from dronemon.frames import GeoPoint
from dronemon.runner.watch import in_words, span, watch
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Measurement

PLACE_AU = (0.3, 0.6)


def log_of(*seen_at: int, length: int = 10, prior: tuple[float, float] | None = None) -> Sightings:
    """A measurement each au; the target is seen at some of them, always at the same place."""
    sightings = Sightings(np.array([prior or (np.nan, np.nan)]))
    for time_au in range(1, length + 1):
        seen = np.array([time_au in seen_at])
        sightings.add(
            Measurement(
                time_au=float(time_au),
                agent_au=np.array([0.5, 0.5]),
                seen=seen,
                target_au=np.where(seen[:, None], [PLACE_AU], np.nan),
            )
        )
    return sightings


def place_of(position_au: FloatArray) -> GeoPoint:
    return GeoPoint(latitude_deg=10.0 * position_au[0], longitude_deg=-position_au[1])


@pytest.mark.parametrize(
    ("seen_at", "num_seen", "longest_s", "since_s"),
    [
        ((), 0, 400.0, None),
        ((10,), 1, 400.0, 0.0),
        ((1, 2, 3), 3, 280.0, 280.0),
        ((2, 8, 9), 3, 240.0, 40.0),
        ((6,), 1, 240.0, 160.0),
    ],
)
@pytest.mark.parametrize("prior", [None, (0.5, 0.5)])
def test_gaps_count_from_start_to_end(seen_at, num_seen, longest_s, since_s, prior):
    watched = watch(log_of(*seen_at, prior=prior), 0, 40.0, place_of)
    assert watched.num_seen == num_seen
    assert watched.longest_unseen_s == pytest.approx(longest_s)
    assert watched.unseen_since_s == (None if since_s is None else pytest.approx(since_s))
    if seen_at:
        assert watched.position_au == pytest.approx(PLACE_AU)
        assert watched.place == place_of(np.array(PLACE_AU))
    else:
        assert watched.position_au is None
        assert watched.place is None


@pytest.mark.parametrize(
    ("seen_at", "words"),
    [
        ((), "never seen in 6 min 40 s"),
        ((10,), "seen once, out of sight for 6 min 40 s at most; last at the end"),
        (
            (2, 8, 9),
            "seen 3 times, out of sight for 4 min at most; last 40 s before the end",
        ),
    ],
)
def test_words(seen_at, words):
    assert in_words(watch(log_of(*seen_at), 0, 40.0, lambda position_au: None)) == words
    if seen_at:
        told = in_words(watch(log_of(*seen_at), 0, 40.0, place_of))
        assert told == f"{words} at 3.000000, -0.600000"


@pytest.mark.parametrize(
    ("duration_s", "words"),
    [(0.2, "0 s"), (59.6, "1 min"), (61, "1 min 1 s"), (3600, "1 h"), (7265, "2 h 1 min")],
)
def test_span(duration_s, words):
    assert span(duration_s) == words
