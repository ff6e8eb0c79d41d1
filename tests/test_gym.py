"""The environment through Gymnasium: its own checker, and the same episodes as `Env`."""

from __future__ import annotations

import sys
from functools import partial
from importlib import import_module
from pathlib import Path
from runpy import run_path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from arenas import U
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st

from dronemon.env import Env, Observation, Setup
from dronemon.errors import OptionError, PlannerError
from dronemon.evaluation.episode import Conditions, fly_episode
from dronemon.gym import Observer
from dronemon.gym.monitoring import DECISIONS, NAME
from dronemon.planner import Briefing, Snapshot, Waypoint
from dronemon.problem import FIRST_TRAINING_SEED, Prior
from dronemon.roadmap import MAX_ADDED_NEIGHBOURS, Roadmap
from dronemon.world import Instance

PPO = Path(__file__).parents[1] / "examples" / "ppo.py"
SPARSE = {"num_targets": 2, "num_nodes": 20, "num_neighbours": 3}
"""A roadmap that falls apart, so that edges are added and nodes have different numbers of them."""


def make(**terms: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(NAME, **SPARSE | terms)


def make_vec(num_envs: int, **terms: Any) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
    return gymnasium.make_vec(NAME, num_envs=num_envs, **SPARSE | terms)


def setup(seed: int, **terms: Any) -> Setup:
    return Setup(seed=seed, num_targets=2, num_nodes=20, **terms)


def assert_shows(shown: dict[str, Any], seen: Observation, env: Env) -> None:
    """What Gymnasium shows of B episodes is what `Env` does, the ways padded."""
    for name, expected in (
        ("position_au", seen.position_au.float()),
        ("time_au", seen.length_au.float()[:, None]),
        ("nodes_au", env.graphs.coordinates),
        ("node", seen.node),
        ("belief", seen.frames),
        ("target_mask", seen.target_mask),
        ("tracks", seen.tracks),
    ):
        np.testing.assert_array_equal(shown[name], expected.numpy(), err_msg=name)
    for b, mask in enumerate(shown["neighbour_mask"].astype(bool)):
        ways = shown["neighbours"][b, shown["node"][b], mask]
        np.testing.assert_array_equal(ways, seen.neighbours[b][seen.neighbour_mask[b]])


@pytest.mark.parametrize(
    "terms",
    [{}, {"action": "waypoint"}, {"prior": "none"}, {"num_nodes": 1}, {"render_mode": "rgb_array"}],
    ids=str,
)
def test_gymnasiums_checker_finds_nothing(terms: dict[str, Any]) -> None:
    check_env(make(**terms).unwrapped)  # warnings are errors here


@pytest.mark.parametrize("prior", ["full", "number", "none"])
def test_lines_are_the_episodes_of_env(prior: str) -> None:
    seeds = [10_000, 10_001, 10_002]
    env, envs = Env(num_neighbours=3), make_vec(3, prior=prior, speed_ratio=0.2)
    seen = env.reset([setup(s, prior=prior, speed_ratio=0.2) for s in seeds])
    shown, infos = envs.reset(seed=10_000)
    assert infos["seed"].tolist() == seeds
    assert_shows(shown, seen, env)
    rng = np.random.default_rng(0)
    for _ in range(25):
        assert shown in envs.observation_space
        actions = np.array([rng.choice(np.flatnonzero(m)) for m in shown["neighbour_mask"]])
        row = np.arange(3)
        nodes = shown["neighbours"][row, shown["node"], actions]
        step = env.step(torch.as_tensor(nodes))
        shown, rewards, terminations, truncations, infos = envs.step(actions)
        assert_shows(shown, step.observation, env)
        np.testing.assert_array_equal(rewards, step.reward)
        np.testing.assert_array_equal(infos["area_std"], step.area_std[:, :2])
        np.testing.assert_allclose(
            infos["leg_au"], (step.observation.length_au - seen.length_au).numpy()
        )
        assert not terminations.any()
        assert not truncations.any()
        seen = step.observation


@pytest.mark.lengthy
@pytest.mark.parametrize("action", ["neighbour", "waypoint"])
def test_many_in_step_are_gymnasiums_own_vector_of_single_ones(action: str) -> None:
    terms = {"action": action, "max_episode_steps": 4}
    fast = make_vec(3, **terms)
    slow = SyncVectorEnv([lambda: make(**terms)] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    assert fast.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert fast.action_space == slow.action_space
    assert fast.observation_space == slow.observation_space
    got, expected = (
        fast.reset(seed=[10_005, 10_003, 10_007]),
        slow.reset(seed=[10_005, 10_003, 10_007]),
    )
    fast.action_space.seed(0)
    for number in range(10):  # through two ends
        assert_alike(got, expected)
        actions = fast.action_space.sample()
        got, expected = fast.step(actions), slow.step(actions)
        assert got[3].all() == (number % 4 == 3)
        assert ("final_obs" in got[4]) == (number % 4 == 3)


def assert_alike(got: Any, expected: Any) -> None:
    """Nested values are the same but for rounding in batches of another size."""
    assert type(got) is type(expected)
    if isinstance(got, dict):
        assert got.keys() == expected.keys()
        got, expected = ([x[k] for k in sorted(x)] for x in (got, expected))
    if isinstance(got, np.ndarray) and got.dtype != object:
        assert got.dtype == expected.dtype
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6)
    elif isinstance(got, list | tuple | np.ndarray):
        for one, other in zip(got, expected, strict=True):
            assert_alike(one, other)
    else:
        assert got == pytest.approx(expected, abs=1e-9)


def test_a_limit_truncates_and_nothing_terminates() -> None:
    env = make(max_episode_steps=3)
    env.reset(seed=10_000)
    ends = [env.step(0)[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]
    assert gymnasium.spec(NAME).max_episode_steps == DECISIONS == 256


def test_every_action_is_a_way_and_those_past_the_last_count_round() -> None:
    env = make()
    reached = []
    for action in range(int(env.action_space.n)):
        before, _ = env.reset(seed=10_003)
        reached.append(env.step(action)[0]["node"])
    count = int(before["neighbour_mask"].sum())
    assert 2 <= count < len(reached)
    assert reached[:count] == before["neighbours"][0, :count].tolist()
    assert reached[count:] == [reached[a % count] for a in range(count, len(reached))]


def test_a_waypoint_is_flown_to_and_its_nearest_node_told() -> None:
    env = make(action="waypoint")
    shown, _ = env.reset(seed=10_000)
    for place in ((0.25, 0.75), (1.0, 0.0), (1.0, 0.0)):
        before_au = shown["time_au"][0]
        leg_au = np.linalg.norm(shown["position_au"] - place)
        shown, _, _, _, info = env.step(np.array(place))
        assert shown["position_au"].tolist() == list(place)
        assert info["leg_au"] == pytest.approx(leg_au, abs=1e-6)
        assert shown["time_au"][0] == pytest.approx(before_au + leg_au, abs=1e-6)
        distance_au = np.linalg.norm(shown["nodes_au"] - place, axis=1)
        assert shown["node"] == distance_au.argmin()


def test_episodes_without_a_seed_are_those_for_training_and_follow_from_the_last_seed() -> None:
    env = make()
    drawn = []
    for _ in range(2):
        assert env.reset(seed=7)[1] == {"seed": 7}
        drawn.append([env.reset()[1]["seed"] for _ in range(3)])
    assert drawn[0] == drawn[1]
    assert len(set(drawn[0])) == 3
    assert min(drawn[0]) >= FIRST_TRAINING_SEED


@pytest.mark.parametrize(
    ("terms", "words"),
    [
        ({"num_targets": 0}, "num_targets is 0; it can be a whole number from 1 to 100"),
        ({"num_nodes": 0}, "num_nodes is 0"),
        ({"num_neighbours": 1}, "num_neighbours is 1"),
        ({"num_nodes": 2.5}, "num_nodes is 2.5; it can be a whole number from 1 to 2000"),
        ({"num_targets": "3"}, "num_targets is '3'; it can be a whole number"),
        ({"num_threads": 0}, "num_threads is 0"),
        ({"speed_ratio": 1.0}, "speed_ratio is 1.0; it can be from 0 to below 1"),
        ({"speed_ratio": "fast"}, "speed_ratio is 'fast'"),
        ({"prior": "some"}, "prior is 'some'; it can be full, number or none"),
        ({"action": "turn"}, "action is 'turn'; it can be neighbour or waypoint"),
        ({"num_target": 3}, "no term 'num_target'; did you mean num_targets"),
        ({"bogus": 1}, "no term 'bogus'; it has num_targets, num_nodes, .*, num_threads$"),
    ],
)
def test_terms_that_cannot_be_are_explained(terms: dict[str, Any], words: str) -> None:
    for make_one in (make, partial(make_vec, 2)):
        with pytest.raises(OptionError, match=words):
            make_one(**terms)


def test_what_cannot_be_asked_is_explained() -> None:
    env, envs = make(disable_env_checker=True), make_vec(2)
    with pytest.raises(OptionError, match="no options, and was given 'num_nodes'"):
        env.reset(options={"num_nodes": 3})
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(np.zeros(2, dtype=np.int64))
    for ask in (lambda: env.unwrapped.step(0), make_vec(2, render_mode="rgb_array").render):
        with pytest.raises(gymnasium.error.ResetNeeded, match="call reset first"):
            ask()
    with pytest.raises(OptionError, match="3 seeds for 2 episodes"):
        envs.reset(seed=[1, 2, 3])
    for steps in (1.5, float("nan"), None, 0):
        with pytest.raises(OptionError, match=r"max_episode_steps is .*; it can be a whole number"):
            make_vec(2, max_episode_steps=steps)
    with pytest.raises(OptionError, match="num_envs is 0"):
        make_vec(0)
    with pytest.raises(OptionError, match="render_mode is 'human'"):
        make_vec(2, render_mode="human")
    env.reset(seed=10_000)
    envs.reset(seed=10_000)
    for wrong in (-1, 99, 0.5):
        with pytest.raises(ValueError, match="is not in the action space"):
            env.step(wrong)
    for wrong in ([0], [0, 99], [[0, 0]]):
        with pytest.raises(ValueError, match="is not in the action space"):
            envs.step(np.array(wrong))
    free = make(action="waypoint", disable_env_checker=True)
    free.reset(seed=10_000)
    for place in ([0.5, 1.1], [np.nan, 0.5], [0.5]):
        with pytest.raises(ValueError, match="is not in the action space"):
            free.step(np.array(place))


class Wanderer:
    """A planner that goes any way, and keeps what it observed and which ways it took."""

    name = "wanderer"

    def __init__(self) -> None:
        self._observer, self._rng = Observer(), np.random.default_rng(0)

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        self._observer.reset(briefing, roadmap)
        self.shown: list[dict[str, Any]] = []
        self.ways: list[int] = []

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        self.shown.append(self._observer.observe(snapshot))
        self.ways.append(int(self._rng.integers(len(self.shown[-1]["neighbour_mask"]))))
        return self._observer.waypoint(self.ways[-1])


def test_a_mission_in_another_field_is_refused() -> None:
    instance = Instance.draw(10_000, 2, arena=U)
    with pytest.raises(PlannerError, match="search, tsp and lawnmower fly"):
        fly_episode(Wanderer(), instance, Conditions(speed_ratio=0.1, num_nodes=20))


@pytest.mark.lengthy
@pytest.mark.parametrize(("prior", "num_neighbours"), [("full", 2), ("number", 3), ("none", 10)])
def test_a_mission_is_observed_as_the_episode_of_its_seed(
    prior: Prior, num_neighbours: int
) -> None:
    env = make(prior=prior, num_targets=3, num_neighbours=num_neighbours)
    conditions = Conditions(
        speed_ratio=0.1,
        prior=prior,
        horizon_au=6.0,
        num_nodes=SPARSE["num_nodes"],
        num_neighbours=num_neighbours,
    )
    planner = Wanderer()
    for seed in (10_002, 10_000):  # one object flies many missions
        fly_episode(planner, Instance.draw(seed, 3), conditions)
        expected, _ = env.reset(seed=seed)
        for shown, way in zip(planner.shown, planner.ways, strict=True):
            columns = np.flatnonzero(expected["target_mask"])
            if prior == "none":  # those known come in the order in which they were found
                tracks = expected["tracks"][columns]
                offset = np.abs(shown["tracks"][:, None] - tracks).sum(axis=2)
                columns = columns[offset.argmin(axis=1)]
                assert columns[-1] == 3  # the one imagined is the last
            told = {
                "belief": expected["belief"][:, columns],
                "target_mask": expected["target_mask"][columns],
                "tracks": expected["tracks"][columns],
            }
            assert_alike(shown, expected | told)
            expected, *_ = env.step(way)
        assert len(planner.shown) > 8
        assert len(columns) > 1


def test_without_gymnasium_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [n for n in sys.modules if n.partition(".")[0] == "gymnasium"]:
        monkeypatch.setitem(sys.modules, name, None)
    for name in [n for n in sys.modules if n.startswith("dronemon.gym")]:
        monkeypatch.delitem(sys.modules, name)
    for begin in (lambda: import_module("dronemon.gym"), lambda: run_path(str(PPO))):
        with pytest.raises(ImportError, match=r"pip install 'dronemon\[gym\]'"):
            begin()


def test_a_picture_shows_the_agent_north_up() -> None:
    env = make(action="waypoint", render_mode="rgb_array")
    env.reset(seed=10_000)
    env.step(np.array([0.25, 0.9]))
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    height, width, _ = picture.shape
    assert picture[int(0.1 * height), int(0.25 * width)].tolist() == [255, 255, 255]
    assert picture[int(0.9 * height), int(0.25 * width)].tolist() != [255, 255, 255]
    envs = make_vec(2, render_mode="rgb_array")
    envs.reset(seed=10_000)
    pictures = envs.render()
    assert pictures is not None
    assert [p.shape for p in pictures] == [picture.shape] * 2


@settings(max_examples=60)
@given(st.integers(10_000, 10**6), st.integers(1, 40), st.integers(2, 5))
def test_no_node_is_given_more_edges_than_the_spaces_have_room_for(
    seed: int, num_nodes: int, num_neighbours: int
) -> None:
    instance = Instance.draw(seed, 1)
    rng = instance.stream("roadmap")
    roadmap = Roadmap.random(num_nodes, num_neighbours, rng, instance.start_au)
    added = roadmap.neighbours.shape[1] - min(num_neighbours, num_nodes + 1)
    assert added <= MAX_ADDED_NEIGHBOURS
