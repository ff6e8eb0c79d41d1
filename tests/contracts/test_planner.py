"""What every registered planner owes whoever flies it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from arenas import HOLED, U

from dronemon.arena import ARENA, Arena
from dronemon.belief import Belief
from dronemon.errors import OptionError, PlannerError
from dronemon.evaluation.episode import Conditions, fly_episode
from dronemon.planner import (
    Briefing,
    Clairvoyant,
    Planner,
    Snapshot,
    TargetsAt,
    Waypoint,
    create_planner,
    has_weights,
    planner_names,
)
from dronemon.planner.motion import waypoint_flaw
from dronemon.policy import Card, NetworkConfig, PolicyNetwork, save_checkpoint
from dronemon.problem import Prior
from dronemon.roadmap import Roadmap
from dronemon.sightings import Sightings
from dronemon.types import Measurement
from dronemon.world import Instance, TargetPaths, measure

Make = Callable[[], Planner]
CARD = Card(recipe="none", command="", commit="", date="", seeds="")
HORIZON_AU = 0.7


class Recording:
    """Any planner, with what it was asked and what it answered."""

    def __init__(self, planner: Planner) -> None:
        self.name = planner.name
        self._planner = planner
        self.asked: list[Snapshot] = []
        self.given: list[Waypoint] = []

    def foresee(self, targets_at: TargetsAt) -> None:
        if isinstance(self._planner, Clairvoyant):
            self._planner.foresee(targets_at)

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        self.asked.clear()
        self.given.clear()
        self._planner.reset(briefing, roadmap)

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        self.asked.append(snapshot)
        self.given.append(self._planner.next_waypoint(snapshot))
        return self.given[-1]


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    with torch.random.fork_rng():
        torch.manual_seed(1)
        network = PolicyNetwork(NetworkConfig(width=16, feed_forward=24, tracks=True)).eval()
    path: Path = tmp_path_factory.mktemp("weights") / "untrained.pt"
    save_checkpoint(path, network, CARD)
    return str(path)


@pytest.fixture(params=planner_names(), scope="module")
def make(request: pytest.FixtureRequest, weights: str) -> Make:
    kind: str = request.param

    def create() -> Planner:
        planner = create_planner(kind, checkpoint=weights if has_weights(kind) else None)
        assert planner.name == kind
        return planner

    return create


def conditions(prior: Prior = "full") -> Conditions:
    return Conditions(speed_ratio=0.1, prior=prior, horizon_au=HORIZON_AU, num_nodes=20)


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("num_targets", "prior"),
    [(1, "full"), (3, "number"), (3, "none"), (12, "full")],
)
def test_planner_flies_any_number_of_targets_under_any_prior(
    make: Make, num_targets: int, prior: Prior
) -> None:
    planner = Recording(make())
    episode = fly_episode(planner, Instance.draw(10_004, num_targets), conditions(prior))
    steps_au = np.linalg.norm(np.diff(episode.agent_au, axis=0), axis=1)
    assert len(steps_au) == 7
    assert steps_au.max() <= 0.1 + 1e-9
    for asked, given in zip(planner.asked, planner.given, strict=True):
        assert np.all((given.position_au >= 0.0) & (given.position_au <= 1.0))
        json.dumps(dict(given.details), allow_nan=False)
        if given.node is not None:
            np.testing.assert_array_equal(given.position_au, asked.roadmap.nodes_au[given.node])


def test_planner_repeats_itself_and_remembers_no_earlier_mission(make: Make) -> None:
    instance, other = Instance.draw(10_001, 3), Instance.draw(10_002, 2)
    planner = make()
    first = fly_episode(planner, instance, conditions())
    fly_episode(planner, other, conditions("none"))
    again = fly_episode(planner, instance, conditions())
    fresh = fly_episode(make(), instance, conditions())
    np.testing.assert_array_equal(first.agent_au, again.agent_au)
    np.testing.assert_array_equal(first.agent_au, fresh.agent_au)


class Watched(Sightings):
    """A log that counts the measurements it gives out."""

    num_given = 0

    def since(self, count: int) -> Sequence[Measurement]:
        given = super().since(count)
        self.num_given += len(given)
        return given


@pytest.mark.parametrize("kind", ["search", "search-roadmap", "stamp"])
def test_what_was_seen_before_is_taken_in_before_take_off(kind: str, weights: str) -> None:
    instance = Instance.draw(10_005, 3)
    log = Watched(instance.paths.positions_au(0.0))
    for step in range(1, 41):
        time_au = 0.1 * step
        log.add(measure(time_au, instance.start_au, instance.paths.positions_au(0.1 * time_au)))
    roadmap = Roadmap.random(20, 5, instance.stream("roadmap"), instance.start_au)
    planner = create_planner(kind, checkpoint=weights if has_weights(kind) else None)
    planner.reset(
        Briefing(
            num_targets=3,
            priors_au=log.priors_au,
            start_au=instance.start_au,
            horizon_au=9.0,
            rng=instance.stream("planner"),
            sightings=log,
        ),
        roadmap,
    )
    assert log.num_given >= 40
    log.num_given = 0
    planner.next_waypoint(
        Snapshot(
            time_au=4.0,
            flown_au=4.0,
            position_au=instance.start_au,
            node=0,
            sightings=log,
            belief=Belief(log),
            roadmap=roadmap,
            remaining_au=5.0,
        )
    )
    assert log.num_given == 0


def test_targets_seen_beyond_the_border_stop_nobody(make: Make) -> None:
    outside = np.array([[[1.04, 0.5], [1.04, 0.6]], [[0.5, -0.05], [0.4, -0.05]]])
    instance = Instance(
        seed=10_003, start_au=np.array([0.95, 0.5]), paths=TargetPaths.along(outside)
    )
    planner = Recording(make())
    episode = fly_episode(planner, instance, replace(conditions(), horizon_au=2.0))
    for asked, given in zip(planner.asked, planner.given, strict=True):
        assert waypoint_flaw(given, asked.position_au, ARENA) is None
    steps_au = np.linalg.norm(np.diff(episode.agent_au, axis=0), axis=1)
    assert steps_au.max() <= 0.1 + 1e-9
    assert len(np.unique(episode.agent_au.round(3), axis=0)) > 10


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("arena", "prior"), [(U, "full"), (HOLED, "number")], ids=["U-full", "holed-number"]
)
def test_every_leg_is_free_in_fields_of_any_form(make: Make, arena: Arena, prior: Prior) -> None:
    """That each waypoint can be flown to is checked by the episode."""
    planner, instance = make(), Instance.draw(10_004, 3, "loop", arena=arena)
    in_field = Conditions(speed_ratio=0.1, prior=prior, horizon_au=2.0, num_nodes=60)
    if planner.name == "stamp":
        with pytest.raises(PlannerError, match="search, tsp and lawnmower fly"):
            fly_episode(planner, instance, in_field)
        return
    episode = fly_episode(planner, instance, in_field)
    assert arena.free.contains(episode.agent_au).all()
    assert len(np.unique(episode.agent_au.round(6), axis=0)) > 10


@pytest.mark.parametrize(
    ("waypoint_au", "flaw"),
    [
        ((0.5, np.nan), "no place"),
        ((1.01, 0.5), "not in the arena"),
        ((0.5, 0.5 + 1e-7), "where the agent is"),
        ((0.5, 0.6), None),
        ((0.5, 0.6, 0.7), "not two numbers"),
        (("0.5", "0.6"), "not two numbers"),
        (None, "not two numbers"),
    ],
)
def test_a_waypoint_is_judged(waypoint_au: tuple[float, float], flaw: str | None) -> None:
    judged = waypoint_flaw(Waypoint(position_au=np.array(waypoint_au)), np.array([0.5, 0.5]), ARENA)
    assert judged is None if flaw is None else flaw in str(judged)


def test_unknown_planner_names_the_nearest() -> None:
    with pytest.raises(OptionError, match=r"no planner 'lawnmover'; did you mean lawnmower\?"):
        create_planner("lawnmover")


def test_checkpoint_is_refused_where_there_are_no_weights() -> None:
    with pytest.raises(OptionError, match="'tsp' has no weights, but history 5 was given"):
        create_planner("tsp", history=5)
    with pytest.raises(OptionError, match="'tsp' has no weights"):
        create_planner("tsp", checkpoint="x.pt")
