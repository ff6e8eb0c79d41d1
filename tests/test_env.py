"""The vectorised environment against the single-vehicle code that flies."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from dronemon.arena import ARENA
from dronemon.belief import Belief
from dronemon.belief.grid import evaluation_grid
from dronemon.belief.metrics import area_std
from dronemon.env import Env, Setup
from dronemon.policy import belief_features
from dronemon.roadmap import Roadmap
from dronemon.sightings import Sightings
from dronemon.world import Instance, Roster, TargetPaths, measure, sample_leg

SQUARE = evaluation_grid(ARENA)


@pytest.fixture(autouse=True, scope="module")
def _one_thread():
    """Matrices this small only lose by waiting for a second thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def random_nodes(observation, rng):
    """A random neighbour for each episode, drawn from its own generator."""
    return torch.tensor(
        [
            generator.choice(row[mask].numpy())
            for row, mask, generator in zip(
                observation.neighbours, observation.neighbour_mask, rng, strict=True
            )
        ]
    )


def rollout(env, setups, decisions):
    """Fly at random; each seed makes the same choices in any company."""
    observation = env.reset(setups)
    rng = [np.random.default_rng(setup.seed) for setup in setups]
    steps = []
    for _ in range(decisions):
        nodes = random_nodes(steps[-1].observation if steps else observation, rng)
        kept = nodes.clone()
        steps.append(env.step(nodes))
        assert torch.equal(nodes, kept), "the caller's tensor is the caller's"
    return observation, steps


def stacked(steps, read):
    return torch.stack([read(step) for step in steps])


class Walker:
    """One vehicle with a belief of its own, for comparison."""

    def __init__(self, setup):
        instance = Instance.draw(setup.seed, setup.num_targets)
        self.setup, self.paths = setup, instance.paths
        self.roadmap = Roadmap.random(
            setup.num_nodes, 10, instance.stream("roadmap"), instance.start_au
        )
        self.roster = Roster(setup.prior, self.paths.positions_au(0.0))
        self.sightings = Sightings(self.roster.priors_au)
        self.belief = Belief(self.sightings)
        self.position, self.time, self.residual, self.num_measured = instance.start_au, 0.0, 0.0, 0

    def fly(self, node):
        goal = self.roadmap.nodes_au[node]
        leg = sample_leg(self.position, goal, self.residual)
        for offset, position in zip(leg.offsets_au, leg.positions_au, strict=True):
            time = self.time + offset
            targets = self.paths.positions_au(self.setup.speed_ratio * time)
            self.sightings.add(self.roster.tell(measure(time, position, targets)))
            self.num_measured += 1
        self.time += float(np.linalg.norm(goal - self.position))
        self.position, self.residual = goal, leg.residual_au

    def frame(self):
        frame = torch.tensor([0.0, 1.0, 0.0, 1.0])
        frame = frame.repeat(self.roadmap.num_nodes, self.setup.num_targets, 1)
        frame[:, self.roster.known] = self.features(self.belief)
        return frame

    def imagined(self):
        return self.features(Belief(self.sightings, num_imagined=1))[:, -1]

    def features(self, belief):
        nodes = self.roadmap.nodes_au
        times = np.repeat([self.time, self.time + 2.0], len(nodes))
        query = np.column_stack([np.tile(nodes, (2, 1)), times])
        return belief_features(*(torch.as_tensor(x) for x in belief.posterior(query)))

    def area_std(self):
        targets = self.paths.positions_au(self.setup.speed_ratio * self.time)[self.roster.known]
        time = torch.full(targets.shape[:1], self.time, dtype=torch.float64)
        std = torch.ones(self.setup.num_targets, dtype=torch.float64)
        if self.roster.known:
            known = area_std(
                self.belief.process, torch.as_tensor(targets)[None], time[None], SQUARE
            )[0]
            std[self.roster.known] = known
        return std


@pytest.mark.lengthy
def test_environment_equals_one_vehicle_over_many_short_legs():
    setups = [
        Setup(seed=10_000, num_targets=3, num_nodes=60, speed_ratio=0.1),
        Setup(seed=10_001, num_targets=1, num_nodes=40, speed_ratio=0.9),
        Setup(seed=10_002, num_targets=4, num_nodes=90, speed_ratio=0.0),
        Setup(seed=10_003, num_targets=3, num_nodes=50, speed_ratio=0.1, prior="number"),
        Setup(seed=10_005, num_targets=4, num_nodes=60, speed_ratio=0.05, prior="none"),
    ]
    walkers = [Walker(setup) for setup in setups]
    first, steps = rollout(Env(), setups, 90)
    before = []
    for b, walker in enumerate(walkers):
        shape = walker.roadmap.num_nodes, walker.setup.num_targets
        got = first.frames[b, : shape[0], : shape[1]]
        torch.testing.assert_close(got, walker.frame(), rtol=0, atol=1e-6)
        before.append(walker.area_std())
    for step in steps:
        for b, walker in enumerate(walkers):
            walker.fly(int(step.observation.node[b]))
            shape = walker.roadmap.num_nodes, walker.setup.num_targets
            got = step.observation.frames[b, : shape[0], : shape[1]]
            torch.testing.assert_close(got, walker.frame(), rtol=0, atol=1e-6)
            std = walker.area_std()
            torch.testing.assert_close(step.area_std[b, : shape[1]], std, rtol=0, atol=1e-8)
            assert step.area_std[b, shape[1] :].isnan().all()
            reward = (before[b] - std).clamp_min(0.0).sum()
            assert step.reward[b].item() == pytest.approx(reward.item(), abs=1e-8)
            assert step.observation.length_au[b].item() == pytest.approx(walker.time, abs=1e-9)
            before[b] = std
            known = step.observation.target_mask[b].nonzero()[:, 0].tolist()
            expected = sorted(walker.roster.known)
            if walker.setup.prior == "none":
                imagined = step.observation.frames[b, : shape[0], shape[1]]
                torch.testing.assert_close(imagined, walker.imagined(), rtol=0, atol=1e-6)
                expected.append(shape[1])
            assert known == expected
    assert all(walker.num_measured == int(walker.time / 0.1 + 1e-9) for walker in walkers)
    assert 1 <= len(walkers[4].roster.known) < 4, "found some, not all"
    assert min(walker.time for walker in walkers) > 6.0, "long enough for the window to move"


def test_instance_is_the_same_alone_and_in_company():
    setups = [
        Setup(seed=10_000 + k, num_targets=1 + k % 4, num_nodes=60 + 10 * (k % 3))
        for k in range(16)
    ]
    together_first, together = rollout(Env(), setups, 30)
    for k in (0, 7, 10):
        first, alone = rollout(Env(), [setups[k]], 30)
        nodes = stacked(alone, lambda s: s.observation.node)[:, 0]
        assert (nodes == stacked(together, lambda s: s.observation.node)[:, k]).all()
        reward = stacked(together, lambda s: s.reward)[:, k]
        torch.testing.assert_close(
            stacked(alone, lambda s: s.reward)[:, 0], reward, rtol=0, atol=1e-10
        )
        shape = first.frames.shape[1:3]
        got = together_first.frames[k, : shape[0], : shape[1]]
        torch.testing.assert_close(got, first.frames[0], rtol=0, atol=1e-6)
        got = stacked(together, lambda s: s.observation.tracks)[:, k, : shape[1]]
        tracks = stacked(alone, lambda s: s.observation.tracks)[:, 0]
        torch.testing.assert_close(got, tracks, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_instance_is_the_same_in_another_process():
    code = (
        "import torch; from dronemon.env import Env, Setup; torch.set_num_threads(1);"
        "o = Env().reset([Setup(seed=10_003, num_targets=2, num_nodes=50)]);"
        "print(o.neighbours.tolist(), o.frames.double().sum().item())"
    )
    other = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    here = Env().reset([Setup(seed=10_003, num_targets=2, num_nodes=50)])
    neighbours, total = other.stdout.rsplit(maxsplit=1)
    assert neighbours == str(here.neighbours.tolist())
    assert float(total) == pytest.approx(here.frames.double().sum().item(), abs=1e-4)


def test_targets_walk_as_their_paths_say_also_past_the_end():
    env = Env()
    env.reset([Setup(seed=10_004, num_targets=5, num_nodes=20, speed_ratio=0.5)] * 2)
    paths = TargetPaths.along(Instance.draw(10_004, 5).paths.points_au)
    for time in (0.0, 0.3, 7.77, 11.0, 25.0, 300.1):
        got = env._targets_at(torch.tensor([time, time + 0.05], dtype=torch.float64))
        want = paths.positions_au(0.5 * np.array([time, time + 0.05]))
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-12)


def test_order_of_targets_is_the_order_of_their_beliefs():
    few, many = (Setup(seed=10_008, num_targets=n, num_nodes=50) for n in (3, 12))
    _, steps_few = rollout(Env(), [few], 30)
    _, steps_many = rollout(Env(), [many], 30)
    for a, b in zip(steps_few, steps_many, strict=True):
        torch.testing.assert_close(a.observation.frames, b.observation.frames[:, :, :3])


def test_node_that_is_no_neighbour_is_refused():
    env = Env()
    observation = env.reset([Setup(seed=10_009, num_targets=1, num_nodes=50)] * 2)
    allowed = observation.neighbours[0][observation.neighbour_mask[0]].tolist()
    far = next(node for node in range(51) if node not in allowed and node != 0)
    for node in (far, 0):
        with pytest.raises(ValueError, match=r"episode 1: node \d+ is no neighbour of node 0"):
            env.step(torch.tensor([allowed[0], node]))


def test_flying_to_a_nodes_place_is_flying_to_the_node():
    setups = [Setup(seed=10_020 + k, num_targets=2, num_nodes=30) for k in range(3)]
    by_node, by_place = Env(), Env()
    seen, _ = by_node.reset(setups), by_place.reset(setups)
    rng = [np.random.default_rng(setup.seed) for setup in setups]
    for _ in range(20):
        nodes = random_nodes(seen, rng)
        places_au = by_place._nodes_au[torch.arange(3), nodes]
        kept = places_au.clone()
        want, got = by_node.step(nodes), by_place.step_to(places_au)
        assert torch.equal(places_au, kept)
        places_au += 1.0  # the caller's tensor is the caller's
        seen = want.observation
        for name in ("frames", "node", "neighbours", "length_au", "tracks", "position_au"):
            assert torch.equal(getattr(got.observation, name), getattr(seen, name)), name
        assert torch.equal(got.reward, want.reward)


def test_any_place_is_flown_to_straight_and_measured_on_the_way():
    setup = Setup(seed=10_030, num_targets=2, num_nodes=30)
    env, instance = Env(), Instance.draw(10_030, 2)
    env.reset([setup])
    sightings = Sightings(instance.paths.positions_au(0.0))
    position, time, residual = instance.start_au, 0.0, 0.0
    for goal in np.array([[0.9, 0.05], [0.9, 0.05], [0.0, 1.0], [0.51, 0.5]]):
        leg = sample_leg(position, goal, residual)
        for offset, place in zip(leg.offsets_au, leg.positions_au, strict=True):
            targets_au = instance.paths.positions_au(0.1 * (time + offset))
            sightings.add(measure(time + offset, place, targets_au))
        time += float(np.linalg.norm(goal - position))
        position, residual = goal, leg.residual_au
        step = env.step_to(torch.as_tensor(goal)[None])
        assert step.observation.length_au[0].item() == pytest.approx(time, abs=1e-9)
        assert step.observation.position_au[0].tolist() == goal.tolist()
        offset_au = env._nodes_au[0].numpy() - goal
        assert step.observation.node[0] == np.linalg.norm(offset_au, axis=1).argmin()
        truth_au = torch.as_tensor(instance.paths.positions_au(0.1 * time))
        torch.testing.assert_close(env.targets_au[0], truth_au)
        std = area_std(
            Belief(sightings).process, truth_au[None], torch.full((1, 2), time).double(), SQUARE
        )
        torch.testing.assert_close(step.area_std, std, rtol=0, atol=1e-8)
    with pytest.raises(ValueError, match=r"episode 0: \[0.5, 1.2\] is outside the arena"):
        env.step_to(torch.tensor([[0.5, 1.2]], dtype=torch.float64))


@pytest.mark.gpu
def test_device_is_near_the_processor():
    setups = [Setup(seed=10_010 + k, num_targets=3, num_nodes=80) for k in range(4)]
    env, processor = Env(device="cuda"), Env()
    env.reset(setups)
    observation = processor.reset(setups)
    rng = [np.random.default_rng(setup.seed) for setup in setups]
    for _ in range(70):
        nodes = random_nodes(observation, rng)
        want, got = processor.step(nodes), env.step(nodes.cuda())
        observation = want.observation
        frames = got.observation.frames.cpu()
        torch.testing.assert_close(frames, observation.frames, rtol=0, atol=5e-3)
        torch.testing.assert_close(got.reward.cpu(), want.reward, rtol=0, atol=5e-3)
