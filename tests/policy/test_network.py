"""The network that shares its work is the network of the paper, computed plainly."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from instances import random_frames, random_graphs, random_tracks, random_walk, whole_episodes
from naive_network import Noted, naive_verdict
from torch import Tensor

from dronemon.errors import PolicyError
from dronemon.policy import Explanation, Graphs, History, NetworkConfig, PolicyNetwork, explain
from dronemon.policy.tracks import mirrored_tracks

Episodes = tuple[Graphs, Tensor, Tensor, Tensor, Tensor, Tensor]
SMALL = NetworkConfig(width=16, num_heads=4, feed_forward=24)
VARIANTS = {
    "paper": SMALL,
    "without predictions": replace(SMALL, predictions=False),
    "lstm": replace(SMALL, temporal="lstm"),
    "newest": replace(SMALL, newest=True),
    "newest without predictions": replace(SMALL, newest=True, predictions=False),
    "ways": replace(SMALL, ways=True),
    "geometry": replace(SMALL, geometry=True),
    "tracks": replace(SMALL, tracks=True),
    "ours": replace(SMALL, newest=True, ways=True, geometry=True, tracks=True),
    "stride 3": replace(SMALL, stride=3),
}


def make_network(config: NetworkConfig, dtype: torch.dtype = torch.float64) -> PolicyNetwork:
    with torch.random.fork_rng():
        torch.manual_seed(7)
        return PolicyNetwork(config).to(dtype)


def make_episodes(
    sizes: list[tuple[int, int]], length: int, seed: int, dtype: torch.dtype = torch.float64
) -> Episodes:
    """Episodes of different (V, N) in one padded batch: graphs, frames, target mask (B, L, N),
    lengths, nodes, tracks.
    """
    rng = torch.Generator().manual_seed(seed)
    graphs = Graphs.concatenate([random_graphs(v, 6, rng) for v, _ in sizes])
    graphs = replace(
        graphs,
        coordinates=graphs.coordinates.to(dtype),
        eigenvectors=graphs.eigenvectors.to(dtype),
        distances=graphs.distances.to(dtype),
    )
    num_targets = max(n for _, n in sizes)
    frames = random_frames(len(sizes), length, graphs.num_nodes, num_targets, rng).to(dtype)
    exists = torch.tensor([[i < n for i in range(num_targets)] for _, n in sizes])
    # The last target of each episode is found on the way.
    last = torch.arange(num_targets) == exists.sum(1, keepdim=True) - 1
    is_early = torch.arange(length) < length // 3
    mask = exists[:, None] & ~(last[:, None] & is_early[:, None])
    nodes, lengths_au = random_walk(graphs, length, rng)
    tracks = random_tracks(len(sizes), length, num_targets, rng).to(dtype)
    return graphs, frames, mask, lengths_au, nodes, tracks


def naive_all(
    network: PolicyNetwork,
    episodes: Episodes,
    sizes: list[tuple[int, int]],
    history: int,
    noted: list[Noted] | None = None,
) -> tuple[Tensor, Tensor]:
    """Every decision of every episode by the reference, each episode without its padding.

    noted: is given the weights of each decision, an episode after the other
    """
    graphs, frames, mask, lengths_au, nodes, tracks = episodes
    noted = [] if noted is None else noted
    logits, values = [], []
    for b, (v, n) in enumerate(sizes):
        own = graphs.select(torch.tensor([b]))
        own = Graphs(
            coordinates=own.coordinates[:, :v],
            eigenvectors=own.eigenvectors[:, :v],
            neighbours=own.neighbours[:, :v],
            neighbour_mask=own.neighbour_mask[:, :v],
            distances=own.distances[:, :v, :v],
            node_mask=own.node_mask[:, :v],
        )
        for t in range(frames.shape[1]):
            noted.append([])
            logit, value = naive_verdict(
                network,
                own,
                frames[b, : t + 1, :v, :n],
                mask[b, : t + 1, :n],
                lengths_au[b, : t + 1],
                (int(nodes[b, t]), int(nodes[b, max(0, t - 1)])),
                history,
                tracks[b, t, :n],
                noted[-1],
            )
            logits.append(logit)
            values.append(value)
    shape = frames.shape[:2]
    return torch.stack(logits).view(*shape, -1), torch.stack(values).view(shape)


def scalar(logits: Tensor, values: Tensor) -> Tensor:
    """One number that depends on everything the network said."""
    finite = torch.where(logits.isfinite(), logits, torch.zeros_like(logits))
    weights = torch.linspace(-1.0, 1.0, finite.numel(), dtype=finite.dtype).view_as(finite)
    return (finite * weights).sum() + (values**2).sum() + logits.softmax(-1).square().sum()


CASES = [("paper", history) for history in (1, 4, 5, 8, 10, 100)] + [
    (variant, 8) for variant in VARIANTS if variant != "paper"
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """What the reference says of every decision of some episodes."""

    network: PolicyNetwork
    history: int
    episodes: Episodes
    logits: Tensor
    values: Tensor
    weights: list[Noted]


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}-{case[1]}", scope="module")
def reference(request: pytest.FixtureRequest) -> Reference:
    variant, history = request.param
    sizes = [(8, 2), (11, 3)]
    network = make_network(VARIANTS[variant])
    episodes, weights = make_episodes(sizes, length=13, seed=history), list[Noted]()
    logits, values = naive_all(network, episodes, sizes, history, weights)
    return Reference(
        network=network,
        history=history,
        episodes=episodes,
        logits=logits,
        values=values,
        weights=weights,
    )


@pytest.mark.lengthy
def test_outputs_and_gradients_of_a_segment_equal_the_reference(reference: Reference) -> None:
    network, history = reference.network, reference.history
    logits, values = reference.logits, reference.values
    graphs, frames, mask, lengths_au, nodes, tracks = reference.episodes
    segment = whole_episodes(graphs, frames, mask, lengths_au, nodes, tracks)
    verdict = network(segment, history)
    torch.testing.assert_close(verdict.logits, logits, rtol=0.0, atol=1e-9)
    torch.testing.assert_close(verdict.value, values, rtol=0.0, atol=1e-9)
    ours = torch.autograd.grad(
        scalar(verdict.logits, verdict.value), network.parameters(), allow_unused=True
    )
    theirs = torch.autograd.grad(scalar(logits, values), network.parameters(), allow_unused=True)
    for (name, parameter), a, b in zip(network.named_parameters(), ours, theirs, strict=True):
        zero = torch.zeros_like(parameter)
        torch.testing.assert_close(
            zero if a is None else a, zero if b is None else b, rtol=1e-7, atol=1e-8, msg=name
        )


def test_one_decision_after_another_equals_the_reference(reference: Reference) -> None:
    logits, values = reference.logits, reference.values
    graphs, frames, mask, lengths_au, nodes, tracks = reference.episodes
    memory = History(reference.network, graphs, reference.history)
    for t in range(frames.shape[1]):
        given = mask[:, t], lengths_au[:, t], nodes[:, t], tracks[:, t]
        verdict = memory.decide(frames[:, t], *given)
        torch.testing.assert_close(verdict.logits[:, 0], logits[:, t], rtol=0.0, atol=1e-9)
        torch.testing.assert_close(verdict.value[:, 0], values[:, t], rtol=0.0, atol=1e-9)


def assert_explained(
    network: PolicyNetwork,
    explained: Explanation,
    noted: Noted,
    masks: tuple[Tensor, Tensor],
    atol: float,
) -> None:
    """All weights are the reference's, which notes those of every node.

    masks: (k,) of neighbours, (N,) of known targets
    """
    allowed, known = masks
    names = ["target", "spatial", "decoder"]
    if network.config.temporal == "attention":
        names.insert(1, "temporal")
    if network.config.tracks:
        names[-1:-1] = ["targets", "tracks"]
    plain = dict(zip(names, (weights.detach() for weights in noted), strict=True))
    plain["target"] = plain["target"][0, :, :, 0, known]  # of the newest window
    plain["spatial"] = plain["spatial"][0][:, explained.nodes]
    plain["decoder"] = plain["decoder"][:, 0, allowed]
    if "temporal" in plain:
        plain["temporal"] = plain["temporal"][:, :, 0].flip(-1)  # there, the newest is first
    if "tracks" in plain:
        plain["tracks"] = plain["tracks"][:, explained.nodes]
    arrays = explained.arrays()
    others = {"nodes", "pointer"} | ({"ages_au"} if "temporal" in plain else set())
    assert set(arrays) == set(plain) | others
    for name, weights in plain.items():
        found = torch.as_tensor(arrays[name])
        torch.testing.assert_close(found, weights.double(), rtol=0.0, atol=atol, msg=name)


def explained_all(reference: Reference, atol: float) -> None:
    """Explain every decision, and compare it with what the reference notes."""
    network = reference.network
    graphs, frames, mask, lengths_au, nodes, tracks = reference.episodes
    memory, length = History(network, graphs, reference.history), frames.shape[1]
    stride = network.config.stride_for(reference.history)
    for t in range(length):
        _, explained = explain(
            memory, frames[:, t], mask[:, t], lengths_au[:, t], nodes[:, t], tracks[:, t]
        )
        for b, each in enumerate(explained()):
            allowed = graphs.neighbour_mask[b, nodes[b, t]]
            noted = reference.weights[b * length + t]
            known = mask[b, t, : noted[0].shape[-1]]
            assert_explained(network, each, noted, (allowed, known), atol)
            neighbours = graphs.neighbours[b, nodes[b, t]][allowed]
            assert each.nodes.tolist() == [int(nodes[b, t]), *neighbours.tolist()]
            chances = reference.logits[b, t].detach().softmax(-1)[allowed]
            np.testing.assert_allclose(each.pointer, chances, rtol=0.0, atol=atol)
            if each.ages_au is not None:
                ends = range(t, -1, -stride)[: math.ceil(reference.history / stride)]
                marks = [lengths_au[b, max(0, e - stride + 1) : e + 1].mean() for e in ends]
                ages_au = [float(lengths_au[b, t] - mark) for mark in reversed(marks)]
                assert each.ages_au == pytest.approx(ages_au, abs=1e-9)


@pytest.mark.lengthy
def test_explained_weights_equal_the_reference(reference: Reference) -> None:
    explained_all(reference, atol=1e-9)


def test_single_precision_at_the_papers_width_stays_within_1e_5() -> None:
    sizes = [(40, 4)]
    network = make_network(NetworkConfig(), torch.float32)
    episodes = make_episodes(sizes, length=27, seed=5, dtype=torch.float32)
    graphs, frames, mask, lengths_au, nodes, tracks = episodes
    segment, weights = whole_episodes(*episodes), list[Noted]()
    with torch.no_grad():
        logits, values = naive_all(network, episodes, sizes, 20, weights)
        verdict = network(segment, 20)
    memory = History(network, graphs, 20)
    torch.testing.assert_close(verdict.logits, logits, rtol=0.0, atol=1e-5)
    torch.testing.assert_close(verdict.value, values, rtol=0.0, atol=1e-5)
    for t in range(frames.shape[1]):
        now = memory.decide(frames[:, t], mask[:, t], lengths_au[:, t], nodes[:, t], tracks[:, t])
        torch.testing.assert_close(now.logits[:, 0], logits[:, t], rtol=0.0, atol=1e-5)
    explained_all(
        Reference(
            network=network,
            history=20,
            episodes=episodes,
            logits=logits,
            values=values,
            weights=weights,
        ),
        atol=1e-5,
    )


def test_an_endless_mission_keeps_its_precision() -> None:
    network = make_network(SMALL, torch.float32)
    graphs, frames, mask, lengths_au, nodes, tracks = make_episodes([(12, 2)], 20, 1, torch.float32)
    near, far = History(network, graphs, 10), History(network, graphs, 10)
    for t in range(20):
        now = near.decide(frames[:, t], mask[:, t], lengths_au[:, t], nodes[:, t], tracks[:, t])
        later = far.decide(
            frames[:, t], mask[:, t], lengths_au[:, t] + 1e6, nodes[:, t], tracks[:, t]
        )
        torch.testing.assert_close(now.logits, later.logits, rtol=0.0, atol=1e-5)


def test_the_order_of_targets_does_not_matter() -> None:
    network = make_network(VARIANTS["ours"])
    graphs, frames, mask, lengths_au, nodes, tracks = make_episodes([(12, 4)], 11, 2)
    segment = whole_episodes(graphs, frames, mask, lengths_au, nodes, tracks)
    order = torch.tensor([2, 0, 3, 1])
    verdict = network(segment, 10)
    turned = replace(
        segment,
        frames=segment.frames[:, :, :, order],
        target_mask=segment.target_mask[:, :, order],
        tracks=segment.tracks[:, :, order],
    )
    other = network(turned, 10)
    torch.testing.assert_close(verdict.logits, other.logits, rtol=0.0, atol=1e-12)


def test_a_target_seen_for_the_first_time_joins_the_history() -> None:
    network = make_network(VARIANTS["ours"])
    graphs, frames, _, lengths_au, nodes, tracks = make_episodes([(12, 3)], 6, 2)
    memory = History(network, graphs, 10)
    for t, known in enumerate([1, 1, 2, 2, 3, 3]):
        verdict = memory.decide(
            frames[:, t, :, :known],
            torch.ones(1, known, dtype=torch.bool),
            lengths_au[:, t],
            nodes[:, t],
            tracks[:, t, :known],
        )
        assert bool(verdict.logits.isfinite().any())


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("history", [3, 10])
def test_a_phase_alone_is_judged_as_among_all_decisions(variant: str, history: int) -> None:
    network = make_network(VARIANTS[variant])
    segment = whole_episodes(*make_episodes([(12, 2), (9, 3)], 23, 4))
    whole = network(segment, history)
    stride = network.config.stride_for(history)
    for phase in range(stride):
        part = network(segment, history, phase)
        torch.testing.assert_close(part.logits, whole.logits[:, phase::stride])
        torch.testing.assert_close(part.value, whole.value[:, phase::stride])


def test_later_decisions_do_not_change_earlier_ones() -> None:
    network = make_network(VARIANTS["ours"])
    graphs, frames, mask, lengths_au, nodes, tracks = make_episodes([(12, 2)], 23, 4)
    whole = network(whole_episodes(graphs, frames, mask, lengths_au, nodes, tracks), 10)
    start = (x[:, :9] for x in (frames, mask, lengths_au, nodes, tracks))
    part = network(whole_episodes(graphs, *start), 10)
    torch.testing.assert_close(whole.logits[:, :9], part.logits, rtol=0.0, atol=1e-12)


def test_symmetries_of_the_square_are_eight_and_keep_distances() -> None:
    rng = torch.Generator().manual_seed(0)
    graphs = Graphs.concatenate([random_graphs(9, 4, rng)] * 1).select(torch.zeros(8, dtype=int))
    turned = graphs.mirrored(torch.arange(8)).coordinates
    assert len({tuple(c.flatten().tolist()) for c in turned.round(decimals=4)}) == 8
    for coordinates in turned:
        torch.testing.assert_close(
            torch.cdist(coordinates, coordinates),
            torch.cdist(graphs.coordinates[0], graphs.coordinates[0]),
        )


def test_a_mirrored_segment_is_that_of_the_mirrored_roadmap() -> None:
    network = make_network(VARIANTS["ours"])
    graphs, frames, mask, lengths_au, nodes, tracks = make_episodes([(12, 2)], 9, 6)
    symmetry = torch.tensor([5])
    seen = network(
        whole_episodes(graphs, frames, mask, lengths_au, nodes, tracks).mirrored(symmetry), 8
    )
    turned = mirrored_tracks(tracks, symmetry)
    mirrored = (graphs.mirrored(symmetry), frames, mask, lengths_au, nodes, turned)
    logits, _ = naive_all(network, mirrored, [(12, 2)], 8)
    torch.testing.assert_close(seen.logits, logits, rtol=0.0, atol=1e-9)


def test_the_papers_network_has_the_papers_weights() -> None:
    d = 128
    attention, layer = 4 * d * d, 2 * 2 * d + 2 * 4 * d * d + 4 * d + d
    encoders = 3 * d + 5 * d + 2 * d + (32 + 1) * d
    decoder = (d + 2) * d + 2 * d * d + d + 1
    total = sum(p.numel() for p in PolicyNetwork(NetworkConfig()).parameters())
    assert total == 4 * (attention + layer) + encoders + decoder


def test_a_width_that_heads_do_not_divide_is_refused() -> None:
    with pytest.raises(PolicyError, match="no multiple of 4 heads"):
        NetworkConfig(width=30)
