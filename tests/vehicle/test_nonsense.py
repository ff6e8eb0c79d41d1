"""Ten thousand messages of nonsense: the vehicle's state stays readable, and nothing raises."""

from __future__ import annotations

import math
import random

from dronemon.vehicle.telemetry import Telemetry

NUM_MESSAGES = 10_000
NUMBERS = (
    *(0, 1, -1, 3, 12, 255, 2**31, 2**32, 2**64, -(2**63), 0.5, 1e300, -1e300),
    *(math.nan, math.inf, -math.inf),
)
OTHERS = (None, "", "nan", "x" * 300, "\x1b[2J", "\ud800", [], [1.0], {}, {"x": 1}, True)
FIELDS = (
    *(
        "autopilot",
        "type",
        "base_mode",
        "custom_mode",
        "system_status",
        "time_boot_ms",
        "time_usec",
    ),
    *("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw", "lat", "lon", "alt", "latitude"),
    *("longitude", "altitude", "landed_state", "battery_remaining", "flags", "severity", "text"),
    *("onboard_control_sensors_health", "id", "chunk_seq", "reset_counter"),
)


def test_nonsense_is_counted_and_left_out():
    telemetry, rng = Telemetry(), random.Random(1)
    for _ in range(NUM_MESSAGES):
        fields = {
            name: rng.choice(NUMBERS if rng.random() < 0.7 else OTHERS)
            for name in FIELDS
            if rng.random() < 0.8
        }
        telemetry.take(rng.choice(telemetry.messages), fields)
        pose = telemetry.pose
        if pose is not None:
            numbers = (*pose.position_ned_m, *pose.velocity_ned_m_s, *pose.attitude_rad)
            assert all(math.isfinite(number) for number in numbers)
        assert telemetry.state.describe()
        for said in telemetry.said():
            assert said.text.isprintable()
    assert telemetry.state.num_unreadable > NUM_MESSAGES / 2
