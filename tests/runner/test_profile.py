"""How high a patrol is over places, and how it climbs on the way over them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dronemon.runner.profile import Profile
from dronemon.vision.surface import Plane

metres = st.floats(-1e4, 1e4)
points = st.tuples(metres, metres)
speeds = st.tuples(st.floats(-20, 20), st.floats(-20, 20))


class Slope:
    """Rises to the north by 1 in 5, falls to the east by 1 in 10."""

    def down_m(self, place_ned_m):
        place = np.asarray(place_ned_m)
        return 3.0 - 0.2 * place[..., 0] + 0.1 * place[..., 1]


@given(place=points, velocity=speeds, down=st.floats(-600, 600), altitude=st.floats(2, 500))
def test_over_a_plane_it_is_one_height_to_the_last_bit(place, velocity, down, altitude):
    level = Profile(Plane(down), altitude)
    assert level.down_m(place) == down - altitude
    assert level.height_m(place, down) == altitude
    down_m, sinking_m_s = level.motion(place, velocity)
    assert (down_m, sinking_m_s) == (down - altitude, 0.0)
    assert not np.signbit(sinking_m_s)


@given(place=points, velocity=speeds)
def test_it_climbs_as_the_ground_does_on_the_way(place, velocity):
    profile = Profile(Slope(), 30.0)
    down_m, sinking_m_s = profile.motion(place, velocity)
    assert down_m == profile.down_m(place) == pytest.approx(Slope().down_m(place) - 30.0)
    assert sinking_m_s == pytest.approx(-0.2 * velocity[0] + 0.1 * velocity[1], abs=1e-8)
    assert profile.height_m(place, 3.0) == pytest.approx(3.0 - down_m)
    heights_m = profile.heights_m(np.array([place, place]), np.array([3.0, 5.0]))
    assert heights_m == pytest.approx(np.array([3.0, 5.0]) - down_m)
