"""Whose each find is, where targets look alike and where they do not."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from dronemon.sightings import Sightings
from dronemon.types import Measurement
from dronemon.vision.owners import NOBODY, Owners

AGENT_AU = np.array([0.5, 0.5])


def log(
    places: dict[int, tuple[float, float]], num_targets: int, time_au: float = 1.0
) -> Sightings:
    """A log in which some targets were seen once."""
    sightings = Sightings(np.full((num_targets, 2), np.nan))
    seen, target_au = np.zeros(num_targets, np.bool_), np.full((num_targets, 2), np.nan)
    for target, place in places.items():
        seen[target], target_au[target] = True, place
    sightings.add(Measurement(time_au=time_au, agent_au=AGENT_AU, seen=seen, target_au=target_au))
    return sightings


def whose(owners, finds, sightings, time_au=1.1, agent_au=AGENT_AU):
    """finds: look, place, and score if not 0.9"""
    return owners.of(
        [look for look, *_ in finds],
        [rest[0] if rest else 0.9 for _, _, *rest in finds],
        np.array([place for _, place, *_ in finds]).reshape(-1, 2),
        agent_au=agent_au,
        time_au=time_au,
        sightings=sightings,
    )


def test_targets_that_look_alike_keep_who_they_are_while_they_are_watched():
    sightings = log({0: (0.48, 0.5), 1: (0.52, 0.5), 2: (0.5, 0.55)}, 4)
    places = [(0.5, 0.553), (0.478, 0.501), (0.523, 0.499)]
    owners = Owners(["zebra"] * 4)
    for order in itertools.permutations(range(3)):
        finds = [("zebra", places[i]) for i in order]
        assert whose(owners, finds, sightings) == [[2, 0, 1][i] for i in order]


def test_all_finds_together_decide_and_not_the_nearest_one():
    """Both moved right: the first is now nearer to where the second was."""
    sightings = log({0: (0.48, 0.5), 1: (0.51, 0.5)}, 2)
    finds = [("zebra", (0.50, 0.5)), ("zebra", (0.53, 0.5))]
    assert whose(Owners(["zebra", "zebra"]), finds, sightings) == [0, 1]


def test_who_should_be_in_the_picture_is_likelier_than_who_should_not():
    """Midway between two places of long ago; one of them is in view, and nothing else is found."""
    sightings = log({0: (0.47, 0.5), 1: (0.63, 0.5)}, 2)
    assert whose(Owners(["zebra", "zebra"]), [("zebra", (0.55, 0.5))], sightings, 2.0) == [0]


def test_a_find_where_none_can_be_is_nobodys_and_a_new_one_is_the_first_unseen():
    seen = log({0: (0.48, 0.5), 1: (0.52, 0.5)}, 2)
    far = [("zebra", (0.48, 0.5)), ("zebra", (0.52, 0.5)), ("zebra", (0.5, 0.58))]
    assert whose(Owners(["zebra"] * 2), far, seen) == [0, 1, NOBODY]
    seen = log({0: (0.48, 0.5), 1: (0.52, 0.5)}, 3)
    assert whose(Owners(["zebra"] * 3), far, seen) == [0, 1, 2]


def test_one_with_a_look_of_its_own_is_never_mistaken_however_far_it_went():
    sightings = log({0: (0.1, 0.1), 1: (0.5, 0.5)}, 2)
    finds = [("cow", (0.52, 0.52), 0.6), ("cow", (0.48, 0.5), 0.8), ("deer", (0.5, 0.5))]
    assert whose(Owners(["cow", "fox"]), finds, sightings) == [NOBODY, 0, NOBODY]


def test_confusion_lets_a_find_be_of_another_look_if_nothing_else_explains_it():
    sightings = log({0: (0.47, 0.5), 1: (0.53, 0.5)}, 2)
    owners = Owners(["horse", "cow"], {"horse": {"cow": 0.2}})
    assert whose(owners, [("cow", (0.47, 0.5))], sightings) == [0]
    assert whose(owners, [("cow", (0.53, 0.5))], sightings) == [1]
    assert whose(owners, [("cow", (0.47, 0.5)), ("cow", (0.53, 0.5))], sightings) == [0, 1]
    for exact in (Owners(["horse", "cow"]), Owners(["horse", "cow"], {"horse": {"cow": 0.0}})):
        assert whose(exact, [("cow", (0.47, 0.5))], sightings) == [1]


@pytest.mark.parametrize("looks", [[], ["tiger"], ["zebra"]])
def test_finds_of_no_target_are_nobodys(looks):
    finds = [(look, (0.5, 0.5)) for look in looks]
    expected = [0 if look == "zebra" else NOBODY for look in looks]
    assert whose(Owners(["zebra", "zebra"]), finds, log({}, 2)) == expected


def test_ten_that_graze_in_view_keep_who_they_are():
    rng = np.random.default_rng(10_000)
    owners, sightings = Owners(["zebra"] * 10), Sightings(np.full((10, 2), np.nan))
    places, met = rng.uniform(0.4, 0.6, (10, 2)), {}
    for step in range(60):
        places += rng.normal(0.0, 0.001, places.shape)
        finds = [("zebra", place) for place in places + rng.normal(0.0, 0.001, places.shape)]
        own = whose(owners, finds, sightings, 0.1 * step)
        assert sorted(set(own)) == sorted(own) == list(range(10))
        for true, target in enumerate(own):
            assert met.setdefault(target, true) == true
        target_au = np.full((10, 2), np.nan)
        target_au[own] = [place for _, place in finds]
        sightings.add(
            Measurement(
                time_au=0.1 * step, agent_au=AGENT_AU, seen=np.ones(10, bool), target_au=target_au
            )
        )
