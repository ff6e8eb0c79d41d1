"""The parameter protocol with a vehicle that loses messages, in memory."""

from __future__ import annotations

import asyncio
import math
import struct

import pytest

from dronemon.errors import CommandRejected, LinkLost, OptionError
from dronemon.vehicle.parameters import Parameters, decoded, encoded

INT32, REAL32 = 6, 9


class Vehicle:
    """Answers what it has; `lost` of its first answers never come."""

    def __init__(self, lost: int = 0) -> None:
        self.values = {"A_NUMBER": (INT32, 3), "A_SPEED": (REAL32, 1.5), "BELOW": (INT32, -1)}
        self.lost, self.is_silent, self.is_stubborn = lost, False, False
        self.sent: list[str] = []
        self.parameters = Parameters(self.send, self.round_trip)

    async def send(self, message: str, *, param_id: str, **fields) -> None:
        self.sent.append(message)
        if message == "PARAM_SET" and not self.is_stubborn:
            kind, _ = self.values[param_id]
            assert fields["param_type"] == kind
            value = decoded(kind, fields["param_value"])
            self.values[param_id] = kind, int(value) if kind == INT32 else value
        if param_id not in self.values or self.is_silent:
            return
        self.lost -= 1
        if self.lost < 0:
            kind, value = self.values[param_id]
            packed = struct.unpack("<f", struct.pack("<i" if kind == INT32 else "<f", value))[0]
            self.parameters.take(
                {
                    "param_id": param_id,
                    "param_type": kind,
                    "param_value": None if math.isnan(packed) else packed,
                }
            )

    async def round_trip(self) -> None:
        if self.is_silent:
            raise LinkLost("silent")

    def read(self, *names: str) -> dict[str, float]:
        return asyncio.run(self.parameters.read(names))

    def write(self, name: str, value: float) -> None:
        asyncio.run(self.parameters.write(name, value))


def test_what_the_vehicle_has_is_read_and_what_it_has_not_is_missing():
    assert Vehicle().read("A_NUMBER", "A_SPEED", "NONE") == {"A_NUMBER": 3.0, "A_SPEED": 1.5}


def test_lost_answers_are_asked_for_again_and_silence_is_no_answer():
    vehicle = Vehicle(lost=3)
    assert vehicle.read("A_NUMBER", "A_SPEED") == {"A_NUMBER": 3.0, "A_SPEED": 1.5}
    vehicle.is_silent = True
    with pytest.raises(LinkLost):
        vehicle.read("A_NUMBER")


@pytest.mark.parametrize(
    ("name", "value"), [("A_NUMBER", 7), ("A_NUMBER", 1234567), ("A_SPEED", 0.1)]
)
def test_a_value_is_set_and_read_back_though_answers_are_lost(name, value):
    vehicle = Vehicle(lost=2)
    vehicle.write(name, value)
    assert vehicle.values[name][1] == pytest.approx(value)
    vehicle.sent.clear()
    vehicle.write(name, value)
    assert "PARAM_SET" not in vehicle.sent


def test_a_whole_number_is_set_exactly_where_a_float32_would_round_it():
    vehicle = Vehicle()
    for value in (2**24, 2**24 + 1):
        vehicle.write("A_NUMBER", value)
        assert vehicle.values["A_NUMBER"] == (INT32, value)


def test_a_value_that_the_vehicle_does_not_take_is_an_error():
    vehicle = Vehicle()
    vehicle.is_stubborn = True
    with pytest.raises(CommandRejected, match="A_NUMBER: asked for 7 12 times, the vehicle says 3"):
        vehicle.write("A_NUMBER", 7)
    with pytest.raises(CommandRejected, match="has no parameter NONE"):
        vehicle.write("NONE", 7)
    with pytest.raises(OptionError, match="A_NUMBER is a whole number"):
        vehicle.write("A_NUMBER", 7.5)
    assert vehicle.values["A_NUMBER"] == (INT32, 3)


def test_a_whole_number_below_zero_can_neither_be_read_nor_sent():
    vehicle = Vehicle()
    assert math.isnan(vehicle.read("BELOW")["BELOW"])
    with pytest.raises(OptionError, match="below 0"):
        vehicle.write("A_NUMBER", -1)
    with pytest.raises(OptionError, match="more than a parameter can hold"):
        vehicle.write("A_SPEED", 1e300)
    with pytest.raises(OptionError, match="cannot be sent"):
        encoded("A_NUMBER", INT32, 0x7FC00000)


@pytest.mark.parametrize(
    "change",
    [
        {"param_id": None},
        {"param_type": 1},
        {"param_type": None},
        {"param_value": "x"},
        {"param_value": 1e300},
    ],
)
def test_nonsense_is_left_out(change):
    vehicle = Vehicle()
    vehicle.parameters.take({"param_id": "X", "param_type": 9, "param_value": 1.0} | change)
    assert not math.isfinite(vehicle.parameters._heard.get("X", (0, math.nan))[1])
