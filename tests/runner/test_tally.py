"""What a patrol keeps of hours in the air."""

from __future__ import annotations

from array import array
from itertools import pairwise

import numpy as np
import pytest

from dronemon.runner.tally import Tally
from dronemon.sightings import Sightings
from dronemon.types import Pose

LONG_S, POSE_S, PICTURE_S = 600.0, 0.02, 2.4


def moving(time_s, speed_m_s):
    return Pose(
        time_s=time_s,
        position_ned_m=(0.0, 0.0, -30.0),
        velocity_ned_m_s=(speed_m_s, 0.0, 0.0),
        attitude_rad=(0.0, 0.0, 0.0),
    )


def test_hours_take_little_memory_and_the_distance_at_each_picture_is_exact():
    times_s = np.arange(0.0, LONG_S, POSE_S)
    speeds_m_s = np.random.default_rng(1).uniform(3.0, 6.0, len(times_s))
    tally = Tally(start_s=0.0, sightings=Sightings(np.zeros((1, 2))))
    due_s, flown_m = PICTURE_S, [0.0]
    for last, pose in pairwise(map(moving, times_s.tolist(), speeds_m_s.tolist())):
        tally.move(last, pose)
        tally.cross_track_m.append(0.1)
        flown_m.append(tally.flown_m)
        if pose.time_s > due_s + 0.5:  # a picture is looked at after a while
            tally.measure(due_s, tally.stretch(due_s).pictured_m, ())
            due_s += PICTURE_S
    exact_m = np.interp(tally.times_s, times_s, flown_m)
    assert len(tally.times_s) == 249
    assert list(tally.pictured_m) == pytest.approx(exact_m.tolist(), rel=1e-12)
    assert tally.flown_m == pytest.approx(np.sum(speeds_m_s[1:]) * POSE_S)
    num_bytes = sum(a.itemsize * len(a) for a in vars(tally).values() if isinstance(a, array))
    assert num_bytes < 300e3


def test_a_measurement_before_the_first_pose_is_where_the_patrol_began():
    tally = Tally(start_s=0.0, sightings=Sightings(np.zeros((1, 2))))
    tally.measure(1.0, tally.stretch(1.0).pictured_m, ())
    assert list(tally.pictured_m) == [0.0]
