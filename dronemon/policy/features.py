"""What the network sees: beliefs at roadmap nodes, pooled over time, and the lengths flown since.

A frame is the belief at one decision; a window is the mean of the `stride` newest frames at a
decision, fewer at the start of an episode. The history of a decision t is the windows that end at
t, t - stride, t - 2 stride, ...: `stride` interleaved phases.

    B episodes   L decisions   V nodes   N targets   k neighbours   s stride   T' windows seen
    F features of a target at a node in a window

Source: paper, section IV-A (observation) and IV-B (average pooling, trajectory length).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from dronemon.policy.tracks import mirrored_tracks
from dronemon.problem import PREDICTION_AU
from dronemon.types import FloatArray, IntArray


def frame_points(nodes_au: Tensor, time_au: Tensor) -> Tensor:
    """Where a frame looks at beliefs: at every node now, then a little later.

    nodes_au: (B, V, 2)
    time_au:  (B,)
    -> (B, 2V, 3) au x, y, t
    """
    times_au = torch.stack([time_au, time_au + PREDICTION_AU], dim=1)
    times_au = times_au.repeat_interleave(nodes_au.shape[1], dim=1)
    return torch.cat([nodes_au.repeat(1, 2, 1), times_au[..., None]], dim=-1)


def belief_features(mean: Tensor, std: Tensor) -> Tensor:
    """Features of every target at every node: mean and std now, then a little later.

    mean, std: (..., N, 2V) posterior at `frame_points` -> (..., V, N, 4) float32
    """
    (mean_now, mean_later), (std_now, std_later) = mean.chunk(2, -1), std.chunk(2, -1)
    features = torch.stack([mean_now, std_now, mean_later, std_later], dim=-1)
    return features.transpose(-3, -2).float()


def num_windows(history: int, stride: int) -> int:
    """T', the windows that a decision sees of `history` frames."""
    # Differs from STAMP: the oldest window is whole where the stride does not divide the history,
    # so that it can be shared.
    return math.ceil(history / stride)


def pool_windows(frames: Tensor, stride: int, first: int = 0, step: int = 1) -> Tensor:
    """Mean over the newest `stride` frames at each decision.

    # Differs from STAMP: at the start of an episode the mean is over the frames there are, not over
    copies of the first.

    frames: (B, L, ...), from the start of an episode -> (B, n, ...), windows that end at frames
    first, first + step, ... of L
    """
    length = frames.shape[1]
    total = frames[:, first::step].clone()
    for back in range(1, min(stride, length)):
        skipped = max(0, -(-(back - first) // step))  # windows that begin later than that
        total[:, skipped:] += frames[:, first + skipped * step - back : length - back : step]
    count = torch.arange(first + 1, length + 1, step, device=frames.device).clamp(max=stride)
    return total / count.to(frames.dtype).view(1, -1, *[1] * (frames.dim() - 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class Graphs:
    """Roadmaps of B episodes, padded to the same V and k.

    coordinates:    (B, V, 2) float32 au
    eigenvectors:   (B, V, E) float32
    neighbours:     (B, V, k) int64
    neighbour_mask: (B, V, k) bool       true where a neighbour may be chosen
    distances:      (B, V, V) float32 au along shortest paths
    node_mask:      (B, V)    bool
    """

    coordinates: Tensor
    eigenvectors: Tensor
    neighbours: Tensor
    neighbour_mask: Tensor
    distances: Tensor
    node_mask: Tensor

    @classmethod
    def of(
        cls,
        nodes_au: FloatArray,
        eigenvectors: FloatArray,
        neighbours: IntArray,
        distance_au: FloatArray,
    ) -> Graphs:
        """One roadmap as a batch of one; a node among its own neighbours is masked.

        eigenvectors: (V, E); the others: as in `Roadmap`
        """
        is_other = neighbours != np.arange(len(nodes_au))[:, None]
        # A node that cannot be reached is as far as the longest path, not infinitely far.
        distances = torch.as_tensor(distance_au).float().clamp(max=2.0 * math.sqrt(2.0))
        return cls(
            coordinates=torch.as_tensor(nodes_au).float()[None],
            eigenvectors=torch.as_tensor(eigenvectors).float()[None],
            neighbours=torch.as_tensor(neighbours)[None],
            neighbour_mask=torch.as_tensor(is_other)[None],
            distances=distances[None],
            node_mask=torch.ones(1, len(nodes_au), dtype=torch.bool),
        )

    @classmethod
    def concatenate(cls, graphs: Sequence[Graphs]) -> Graphs:
        """Batch of batches, padded to the largest V and k."""
        num_nodes = max(g.num_nodes for g in graphs)
        num_neighbours = max(g.neighbours.shape[2] for g in graphs)
        padded = [g.padded(num_nodes, num_neighbours) for g in graphs]
        return cls(**{f.name: torch.cat([getattr(g, f.name) for g in padded]) for f in fields(cls)})

    @property
    def num_nodes(self) -> int:
        """V."""
        return int(self.coordinates.shape[1])

    def padded(self, num_nodes: int, num_neighbours: int) -> Graphs:
        """The same roadmaps with masked nodes and neighbours added."""
        v, k = num_nodes - self.num_nodes, num_neighbours - self.neighbours.shape[2]
        return Graphs(
            coordinates=pad(self.coordinates, (0, 0, 0, v)),
            eigenvectors=pad(self.eigenvectors, (0, 0, 0, v)),
            neighbours=pad(self.neighbours, (0, k, 0, v)),
            neighbour_mask=pad(self.neighbour_mask, (0, k, 0, v)),
            distances=pad(self.distances, (0, v, 0, v)),
            node_mask=pad(self.node_mask, (0, v)),
        )

    def select(self, episodes: Tensor) -> Graphs:
        """Some of the roadmaps. episodes: (b,) int64."""
        return self._each(lambda tensor: tensor[episodes])

    def to(self, device: torch.device) -> Graphs:
        """The same roadmaps on another device."""
        return self._each(lambda tensor: tensor.to(device))

    def _each(self, do: Callable[[Tensor], Tensor]) -> Graphs:
        return Graphs(**{f.name: do(getattr(self, f.name)) for f in fields(self)})

    def mirrored(self, symmetries: Tensor) -> Graphs:
        """The same roadmaps seen in a turned or mirrored square: only coordinates change.

        symmetries: (B,) int64 in 0..7; bit 0 mirrors x, bit 1 mirrors y, bit 2 exchanges them
        """
        bits = (symmetries[:, None] >> torch.arange(3, device=symmetries.device)) & 1
        flipped = torch.where(bits[:, None, :2].bool(), 1.0 - self.coordinates, self.coordinates)
        turned = torch.where(bits[:, 2, None, None].bool(), flipped.flip(-1), flipped)
        return replace(self, coordinates=turned)


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """The first L decisions of B episodes, as the network sees them.

    frames:      (B, L, V, N, 4) float32 belief features
    target_mask: (B, L, N)       bool    targets known of at each decision
    flown:       (B, L)          float32 trajectory length at each decision, in `WINDOW_AU`
    nodes:       (B, L)          int64   the agent's node at each decision
    tracks:      (B, L, N, T)    float32 see `Tracks`
    """

    graphs: Graphs
    frames: Tensor
    target_mask: Tensor
    flown: Tensor
    nodes: Tensor
    tracks: Tensor

    def select(self, episodes: Tensor) -> Segment:
        """Some of the episodes. episodes: (b,) int64."""
        return self._each(self.graphs.select(episodes), lambda tensor: tensor[episodes])

    def to(self, device: torch.device) -> Segment:
        """The same episodes on another device, in float32."""

        def sent(tensor: Tensor) -> Tensor:
            return tensor.to(device, torch.float32 if tensor.is_floating_point() else None)

        return self._each(self.graphs.to(device), sent)

    def mirrored(self, symmetries: Tensor) -> Segment:
        """The same episodes in a turned or mirrored square; see `Graphs.mirrored`."""
        return replace(
            self,
            graphs=self.graphs.mirrored(symmetries),
            tracks=mirrored_tracks(self.tracks, symmetries),
        )

    def _each(self, graphs: Graphs, do: Callable[[Tensor], Tensor]) -> Segment:
        names = [f.name for f in fields(self) if f.name != "graphs"]
        return Segment(graphs=graphs, **{name: do(getattr(self, name)) for name in names})
