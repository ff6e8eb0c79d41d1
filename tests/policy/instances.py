"""Random roadmaps and beliefs for tests of the network; no part of it depends on how real ones
look.
"""

from __future__ import annotations

import torch
from torch import Tensor

from dronemon.policy import Graphs, Segment
from dronemon.policy.tracks import NUM_TRACK_FEATURES
from dronemon.problem import WINDOW_AU


def random_graphs(num_nodes: int, num_neighbours: int, rng: torch.Generator) -> Graphs:
    """A roadmap of uniform nodes; ways are straight lines with detours."""
    coordinates = torch.rand(num_nodes, 2, generator=rng)
    straight = torch.cdist(coordinates, coordinates)
    return Graphs.of(
        nodes_au=coordinates.numpy(),
        eigenvectors=torch.randn(num_nodes, 32, generator=rng).numpy() / num_nodes**0.5,
        neighbours=straight.topk(num_neighbours, largest=False).indices.numpy(),
        distance_au=straight.numpy() * 1.2,
    )


def whole_episodes(
    graphs: Graphs,
    frames: Tensor,
    target_mask: Tensor,
    lengths_au: Tensor,
    nodes: Tensor,
    tracks: Tensor,
) -> Segment:
    """Whole episodes, from the lengths (B, L) in au flown at each decision.

    target_mask: (B, N) always, or (B, L, N) at each decision
    """
    if target_mask.dim() == 2:
        target_mask = target_mask[:, None].expand(-1, frames.shape[1], -1)
    return Segment(
        graphs=graphs,
        frames=frames,
        target_mask=target_mask,
        flown=(lengths_au / WINDOW_AU).to(frames.dtype),
        nodes=nodes,
        tracks=tracks,
    )


def random_frames(
    num_episodes: int, length: int, num_nodes: int, num_targets: int, rng: torch.Generator
) -> Tensor:
    """Belief features of whole episodes. -> (B, L, V, N, F)."""
    return torch.rand(num_episodes, length, num_nodes, num_targets, 4, generator=rng)


def random_tracks(num_episodes: int, length: int, num_targets: int, rng: torch.Generator) -> Tensor:
    """What sightings say of each target. -> (B, L, N, T)."""
    return torch.rand(num_episodes, length, num_targets, NUM_TRACK_FEATURES, generator=rng) - 0.5


def random_walk(graphs: Graphs, length: int, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """Nodes and lengths of random walks. -> (B, L) int64, (B, L) float64 au."""
    nodes = torch.zeros(len(graphs.coordinates), length, dtype=torch.int64)
    lengths_au = torch.zeros(nodes.shape, dtype=torch.float64)
    for episode in range(len(nodes)):
        for step in range(1, length):
            here = int(nodes[episode, step - 1])
            choices = graphs.neighbours[episode, here][graphs.neighbour_mask[episode, here]]
            chosen = choices[torch.randint(len(choices), (1,), generator=rng)]
            nodes[episode, step] = chosen
            leg = graphs.coordinates[episode, chosen] - graphs.coordinates[episode, here]
            lengths_au[episode, step] = lengths_au[episode, step - 1] + leg.double().norm()
    return nodes, lengths_au
