"""What the ground below a flight is, and how far off what is seen on it may be."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from fake_link import ORIGIN
from flights import MISSION

from dronemon.errors import MissionFileError, VehicleError
from dronemon.events import Measured
from dronemon.types import Detection

ASIDE_PX = 120.0
"""As far to the east as 8.25 m are from 22 m up."""


class InTurn:
    """Sees Bella right below a level drone and so many pixels to the east of there, in turn."""

    def __init__(self, aside_px: float) -> None:
        self.pixels_px = itertools.cycle([(320.0, 240.0), (320.0 + aside_px, 240.0)])

    def detect(self, *_: object) -> tuple[Detection, ...]:
        return (Detection(appearance="cow", pixel_px=next(self.pixels_px), score=0.9),)


def sloping(folder: Path, rise_m: float, *, cells: int = 40) -> str:
    """A mission over ground that rises evenly to the east, so much in 100 m."""
    cell_deg = 1e-4
    first = [
        place - 0.5 * cells * cell_deg for place in (ORIGIN.longitude_deg, ORIGIN.latitude_deg)
    ]
    east_m = cell_deg * 111_320.0 * np.cos(np.radians(ORIGIN.latitude_deg))
    row = " ".join(f"{500.0 + rise_m / 100.0 * east_m * column:.3f}" for column in range(cells))
    head = f"ncols {cells}\nnrows {cells}\nxllcorner {first[0]}\nyllcorner {first[1]}\n"
    text = head + f"cellsize {cell_deg}\n" + "\n".join([row] * cells)
    (folder / "ground.asc").write_text(text)
    return MISSION.replace("side_m: 100", "side_m: 100, terrain: ground.asc")


def measured(flight, aside_px: float = ASIDE_PX) -> list[Measured]:
    """What the detector's two pixels say, after what the rehearsal asked of it."""
    flight.detector, before = InTurn(aside_px), len(flight.record.events)
    result = flight.fly()
    assert result.outcome == "completed", result.error
    return [event for event in flight.record.events[before:] if isinstance(event, Measured)]


def away_m(event: Measured) -> float:
    """How far to the east of the drone Bella is."""
    return float(100.0 * (event.measurement.target_au[0, 0] - event.measurement.agent_au[0]))


def test_each_sighting_has_an_error_of_its_own(flight):
    events = sorted(measured(flight), key=away_m)
    assert len(events) == 8
    for event in events:
        assert event.measurement.view_au == 0.1
        (covariance_m2,), (error_m,) = event.covariance_m2, event.error_m
        variances_m2 = np.linalg.eigvalsh(covariance_m2)
        assert variances_m2.min() > 0.0
        assert error_m == pytest.approx(2.4477 * np.sqrt(variances_m2.max()), rel=1e-4)
    below, aside = (event.covariance_m2[0] for event in (events[0], events[-1]))
    assert aside[1, 1] > 1.02 * below[1, 1], "height and focal length tell on what is aside"


def test_what_is_seen_uphill_is_nearer(flight, tmp_path):
    """From 33 m, as hills of 10 m are to stay 21 m below: there the camera sees all it must."""
    high = "altitude_m: 22", "altitude_m: 33"
    for text, away, off in (
        (MISSION, 8.25, 0.02),
        (sloping(tmp_path, 20.0), 8.25 / (1.0 + 0.2 * 0.25), 0.05),  # 80 pixels are 0.25 aside
    ):
        flight.mission_text = text.replace(*high)
        assert max(map(away_m, measured(flight, 80.0))) == pytest.approx(away, abs=off)


def test_over_a_wood_nothing_is_said_of_who_is_not_seen_and_the_drone_is_not_blind(flight):
    """All of the area: finds are on trees, and no picture fails: the camera does all it can."""
    wood = "{name: wood, height_m: 12, polygon_m: [[-90, -90], [90, -90], [90, 90], [-90, 90]]}"
    flight.mission_text = MISSION.replace("side_m: 100", f"side_m: 100, no_fly: [{wood}]")
    looks = [event.measurement for event in measured(flight)]
    assert len(looks) == 8
    for look in looks:
        assert not look.seen.any()
        assert look.view_au == 0.0
        np.testing.assert_array_equal(look.hidden_au, [[0.0, 0.1]] * len(look.hidden_au))


@pytest.mark.parametrize(
    ("rise_m", "cells", "error", "words"),
    [
        (40.0, 40, VehicleError, "set flight.altitude_m to 30 or more"),
        (5.0, 8, MissionFileError, "has no heights of all the area"),
    ],
)
def test_ground_that_cannot_be_flown_over_is_refused(flight, tmp_path, rise_m, cells, error, words):
    flight.mission_text = sloping(tmp_path, rise_m, cells=cells)
    result = flight.fly()
    assert isinstance(result.error, error)
    assert words in str(result.error)
    assert flight.link.commands == []
