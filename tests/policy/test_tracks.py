"""Tracks against sightings made by hand."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from dronemon.policy.tracks import NUM_TRACK_FEATURES, Tracks, mirrored_tracks

PLACE, EXPECTED, VELOCITY = slice(0, 2), slice(2, 4), slice(4, 6)
IS_STRAIGHT, AGE, MISSED, SPEED, IS_PLACED = range(6, 11)
FAR = (0.9, 0.9)


def see(
    tracks: Tracks,
    time: float,
    targets: list[tuple[float, float] | None],
    agent=FAR,
    *,
    row=None,
    view_au=0.1,
) -> None:
    """One measurement; of one episode among several, if `row` is given."""
    num_episodes = 1 if row is None else 2
    places = torch.tensor(
        [[p or (math.nan, math.nan) for p in targets]] * num_episodes, dtype=torch.float64
    )
    active = torch.tensor([row in (None, i) for i in range(num_episodes)])
    tracks.add(
        torch.full((num_episodes,), time, dtype=torch.float64),
        torch.tensor([agent] * num_episodes, dtype=torch.float64),
        torch.tensor([[p is not None for p in targets]] * num_episodes),
        places,
        active,
        view_au,
    )


def features(tracks: Tracks, time: float, num_episodes: int = 1) -> Tensor:
    return tracks.features(torch.full((num_episodes,), time, dtype=torch.float64))[0]


def test_a_contact_gives_place_velocity_and_speed() -> None:
    tracks = Tracks(1, 1)
    for step in range(3):
        see(tracks, 1.0 + 0.1 * step, [(0.5 + 0.01 * step, 0.4)])
    shown = features(tracks, 1.7)[0]
    torch.testing.assert_close(shown[PLACE], torch.tensor([0.02, -0.1]))
    torch.testing.assert_close(shown[VELOCITY], torch.tensor([1.0, 0.0]))  # ten times 0.1 au an au
    torch.testing.assert_close(shown[EXPECTED], torch.tensor([0.07, -0.1]))
    assert shown[AGE] == pytest.approx(math.log1p(0.5))
    assert shown[SPEED] == pytest.approx(1.0)
    assert shown[IS_STRAIGHT] == shown[IS_PLACED] == 1.0
    assert shown[MISSED] == 0.0


def test_a_long_contact_shows_the_way_it_goes_now() -> None:
    tracks = Tracks(1, 1)
    for step in range(20):  # east, then north
        see(tracks, 0.1 * step, [(0.4 + 0.01 * min(step, 10), 0.5 + 0.01 * max(0, step - 10))])
    shown = features(tracks, 1.9)[0]
    torch.testing.assert_close(shown[VELOCITY], torch.tensor([0.0, 1.0]))
    assert shown[IS_STRAIGHT] == 1.0


def test_a_target_is_carried_on_only_for_a_while_and_within_the_square() -> None:
    tracks = Tracks(1, 2)
    for step in range(2):
        see(tracks, 0.1 * step, [(0.5, 0.4 + 0.01 * step), (0.96 + 0.01 * step, 0.5)])
    shown = features(tracks, 20.0)
    torch.testing.assert_close(shown[0, EXPECTED], torch.tensor([0.0, 0.06]))
    torch.testing.assert_close(shown[1, EXPECTED], torch.tensor([0.5, 0.0]))


def test_a_new_contact_has_the_mean_velocity_since_the_last() -> None:
    tracks = Tracks(1, 1)
    tracks.add_prior(torch.tensor([[True]]), torch.tensor([[[0.5, 0.5]]]).double())
    assert features(tracks, 0.0)[0, IS_PLACED] == 1.0
    see(tracks, 2.0, [(0.6, 0.5)])
    shown = features(tracks, 2.0)[0]
    torch.testing.assert_close(shown[VELOCITY], torch.tensor([0.5, 0.0]))
    assert shown[IS_STRAIGHT] == 0.0
    assert shown[SPEED] == 0.0  # who knows how it went there


def test_looking_where_it_should_be_is_remembered_until_it_is_seen() -> None:
    tracks = Tracks(1, 1)
    see(tracks, 0.1, [(0.5, 0.5)])
    see(tracks, 1.0, [None], agent=(0.5, 0.59))
    assert features(tracks, 1.5)[0, MISSED] == pytest.approx(math.exp(-0.5))
    see(tracks, 1.6, [None], agent=(0.5, 0.61))
    see(tracks, 1.6, [None], agent=(0.5, 0.59), view_au=0.08)
    assert features(tracks, 1.6)[0, MISSED] == pytest.approx(math.exp(-0.6))
    see(tracks, 2.0, [(0.5, 0.5)])
    assert features(tracks, 2.0)[0, MISSED] == 0.0


def test_targets_never_placed_and_episodes_that_did_not_measure_show_nothing() -> None:
    tracks = Tracks(2, 1)
    see(tracks, 0.1, [(0.5, 0.5)], row=1)
    shown = tracks.features(torch.ones(2).double())
    assert not shown[0].any()
    assert shown[1, 0, IS_PLACED] == 1.0


def test_targets_that_join_leave_others_alone() -> None:
    tracks, together = Tracks(1, 1), Tracks(1, 2)
    see(tracks, 0.1, [(0.5, 0.5)])
    see(together, 0.1, [(0.5, 0.5), None])
    tracks.widen(2)
    for both in (tracks, together):
        see(both, 0.2, [None, (0.2, 0.2)])
    assert torch.equal(features(tracks, 0.3), features(together, 0.3))


@pytest.mark.parametrize("symmetry", range(8))
def test_tracks_of_a_mirrored_world_are_mirrored_tracks(symmetry: int) -> None:
    def mirror(x: float, y: float) -> tuple[float, float]:
        x, y = (1 - x if symmetry & 1 else x), (1 - y if symmetry & 2 else y)
        return (y, x) if symmetry & 4 else (x, y)

    ours, theirs = Tracks(1, 1), Tracks(1, 1)
    for step in range(3):
        place = (0.3 + 0.02 * step, 0.6 + 0.01 * step)
        see(ours, 0.1 * step, [place], agent=place)
        see(theirs, 0.1 * step, [mirror(*place)], agent=mirror(*place))
    shown = features(ours, 0.9)[None, None]
    assert shown.shape == (1, 1, 1, NUM_TRACK_FEATURES)
    torch.testing.assert_close(
        mirrored_tracks(shown, torch.tensor([symmetry]))[0, 0], features(theirs, 0.9)
    )
