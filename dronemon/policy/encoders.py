"""The network's encoders: of beliefs, of their past, of the roadmap, and of targets' tracks.

Source: paper, section IV-B. The identities that make them cheap are told in `policy.network`.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from dronemon.policy.features import Graphs
from dronemon.policy.layers import HIDDEN, LEG_AU, NetworkConfig, Projections, Residual, rows, take
from dronemon.policy.tracks import NUM_TRACK_FEATURES

_NUM_OFFSETS = 8
_MANY = 4.0
"""Targets over whose number the sum of what they say is divided, to be of order one."""


class TargetEncoder(nn.Module):
    """Node coordinates query the beliefs about all targets there.

    Source: paper, section IV-B, "Target encoder".
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.coordinates = nn.Linear(2, config.width)
        self.belief = nn.Linear(config.num_features, config.width)
        self.attention = Projections(config.width, config.num_heads)
        self.residual = Residual(config.width, config.feed_forward)

    def forward(self, coordinates: Tensor, windows: Tensor, target_mask: Tensor) -> Tensor:
        """Target-aware node features.

        coordinates: (B, V, 2)          au
        windows:     (B, P, V, n, N, F) P phases of n windows
        target_mask: (B, P, n, N)       targets known of
        -> (B, P, V, n, d)
        """
        num_targets = windows.shape[-2]
        maps = self.attention
        place = self.coordinates(coordinates)
        # A score is q . W_K (W_b x + b_b); the part without x is the same for all targets and
        # leaves the softmax as it is.
        key_map = maps.split(maps.key.weight @ self.belief.weight)
        query = maps.heads(maps.query(place)).transpose(1, 2) / math.sqrt(key_map.shape[1])
        narrow = torch.einsum("bvhe,hef->bvhf", query, key_map)  # (B, V, H, F)
        flat = windows.flatten(3, 4)  # (B, P, V, nN, F)
        scores = narrow[:, None] @ flat.transpose(-1, -2)
        scores = scores.view(*scores.shape[:-1], -1, num_targets)  # (B, P, V, H, n, N)
        is_unknown = ~target_mask[:, :, None, None]
        weights = maps.softmax(scores.masked_fill(is_unknown, HIDDEN)).masked_fill(is_unknown, 0.0)
        mixed = (weights[..., None] * windows[:, :, :, None]).sum(-2)  # (B, P, V, H, n, F)
        value_map = maps.split(maps.value.weight @ self.belief.weight)
        out_map = maps.split(maps.out.weight.T)  # (H, d / H, d)
        narrow_out = (value_map.transpose(1, 2) @ out_map).flatten(0, 1)  # (HF, d)
        constant = maps.out(maps.value(self.belief.bias))
        attended = mixed.transpose(3, 4).reshape(*mixed.shape[:3], -1, narrow_out.shape[0])
        result: Tensor = self.residual(place[:, None, :, None], attended @ narrow_out + constant)
        return result


class TemporalEncoder(nn.Module):
    """The newest window of a node queries the node's past.

    Source: paper, section IV-B, "Temporal encoder".
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.length = nn.Linear(1, config.width)
        self.attention = Projections(config.width, config.num_heads)
        self.residual = Residual(config.width, config.feed_forward)

    def project(self, encoded: Tensor) -> tuple[Tensor, Tensor]:
        """Keys and values of windows, but for their time: what every later decision shares.

        encoded: (..., n, d) -> twice (..., H, n, d / H)
        """
        features, maps = encoded + self.length.bias, self.attention
        return maps.heads(maps.key(features)), maps.heads(maps.value(features))

    def forward(
        self,
        encoded: Tensor,
        projected: tuple[Tensor, Tensor],
        flown: Tensor,
        marks: tuple[Tensor, Tensor],
        mask: Tensor | None = None,
    ) -> Tensor:
        """Time-aware node features.

        encoded:   (..., n, d)             the newest window at n decisions
        projected: two (..., H, m, d / H)  keys and values of the m windows of the past
        flown:     (..., n)                at the decisions, from any one origin
        marks:     (..., n) and (..., m)   of the newest windows and of the past, from the same
        mask:      (n, m)                  true where a decision sees a window
        -> (..., n, d)
        """
        maps, rate = self.attention, self.length.weight[:, 0]
        features = encoded + self.length.bias + (flown - marks[0])[..., None] * rate
        query, (keys, values) = maps.heads(maps.query(features)), projected
        query = query / math.sqrt(query.shape[-1])
        past = marks[1][..., None, None, :]  # (..., 1, 1, m)
        # Only narrow products depend on time, not keys and values themselves.
        pull = query @ maps.split(maps.key(rate))[..., None]
        scores = query @ keys.transpose(-1, -2) - pull * past
        if mask is not None:
            scores = scores.masked_fill(~mask, -torch.inf)
        weights = maps.softmax(scores)
        age = flown[..., None, :, None] - (weights * past).sum(-1, keepdim=True)
        mixed = weights @ values + age * maps.split(maps.value(rate))[:, None]
        result: Tensor = self.residual(features, maps.join(mixed))
        return result


class TemporalMemory(nn.Module):
    """The ablation's LSTM: one cell per node, carried along the windows of a phase."""

    # Differs from STAMP: the release runs the cell anew over the last T' windows; carried along,
    # its memory has no end to choose.

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.length = nn.Linear(1, config.width)
        self.cell = nn.LSTM(config.width, config.width, batch_first=True)

    def forward(
        self, encoded: Tensor, gaps: Tensor, state: tuple[Tensor, Tensor] | None = None
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Time-aware node features and the memory to go on with.

        encoded: (..., n, d) successive windows of a phase
        gaps:    (..., n)    length flown since the window before, in units of `WINDOW_AU`
        -> (..., n, d), state of two (1, ..., d)
        """
        features = encoded + self.length(gaps[..., None])
        output, state = self.cell(features.flatten(0, -3), state)
        return output.view_as(encoded), state


class SpatialEncoder(nn.Module):
    """Nodes query all nodes of the roadmap. Source: paper, section IV-B, "Spatial encoder"."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.eigenvectors = nn.Linear(config.num_eigenvectors, config.width)
        self.attention = Projections(config.width, config.num_heads)
        self.residual = Residual(config.width, config.feed_forward)
        self.ways = Ways(config) if config.ways else None

    def forward(self, nodes: Tensor, graphs: Graphs, queried: Tensor) -> Tensor:
        """Spatio-temporal features of the nodes that are asked for.

        nodes:   (B, L, V, d)
        queried: (B, L, q)    the agent's node first
        -> (B, L, q, d)
        """
        features = nodes + self.eigenvectors(graphs.eigenvectors)[:, None]
        asking, maps = take(features, queried), self.attention
        query = maps.heads(maps.query(asking))  # (B, L, H, q, d / H)
        query = query / math.sqrt(query.shape[-1])
        scores = query @ maps.heads(maps.key(features)).transpose(-1, -2)
        if self.ways is not None:
            closeness = self.ways.closeness(rows(graphs.distances, queried), queried)
            scores = scores + self.ways.scores(query, closeness)
        scores = scores.masked_fill(~graphs.node_mask[:, None, None, None], -torch.inf)
        weights = maps.softmax(scores)  # (B, L, H, q, V)
        mixed = weights @ maps.heads(maps.value(features))
        if self.ways is not None:
            mixed = mixed + self.ways.values(weights, closeness)
        result: Tensor = self.residual(asking, maps.join(mixed))
        return result


class Ways(nn.Module):
    """Relative keys and values: how far apart two nodes are, and which way leads where.

    Source: Shaw, Uszkoreit & Vaswani (2018), with R smooth functions of distance for their labels.
    """

    # Differs from STAMP: optional. The paper's nodes know their place and the distance from the
    # agent, but not from each other, and find out what is near a neighbour by coordinates alone.

    REACHES_AU = (0.1, 0.3, 1.0)
    DETOUR_AU = 0.1

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        heads, size = config.num_heads, config.width // config.num_heads
        count = len(self.REACHES_AU) + 1
        start = torch.linspace(0.0, 3.0, heads)[:, None].expand(heads, count)
        self.bias = nn.Parameter(start.clone())
        self.key = nn.Parameter(torch.randn(heads, size, count) / math.sqrt(size))
        self.value = nn.Parameter(torch.randn(heads, count, size) / math.sqrt(count))

    def closeness(self, distances: Tensor, queried: Tensor) -> Tensor:
        """Functions that fall from 1 to 0: of distance, and of the agent's detour by way of a node.

        distances: (B, L, q, V) au from the queried nodes
        queried:   (B, L, q)       the agent's node first
        -> (B, L, q, V, R)
        """
        direct = distances[:, :, 0]
        detours = direct.gather(2, queried)[..., None] + distances - direct[:, :, None]
        falling = [distances / reach_au for reach_au in self.REACHES_AU]
        return torch.exp(-torch.stack([*falling, detours / self.DETOUR_AU], dim=-1))

    def scores(self, query: Tensor, closeness: Tensor) -> Tensor:
        """What relative keys add, for queries (B, L, H, q, e) -> (B, L, H, q, V)."""
        pull = query @ self.key + self.bias[:, None]  # (B, L, H, q, R)
        return (closeness @ pull.permute(0, 1, 3, 4, 2)).permute(0, 1, 4, 2, 3)

    def values(self, weights: Tensor, closeness: Tensor) -> Tensor:
        """What relative values add, for weights (B, L, H, q, V) -> (B, L, H, q, e)."""
        mean = weights.transpose(2, 3) @ closeness.to(weights.dtype)  # (B, L, q, H, R)
        return mean.transpose(2, 3) @ self.value


class TrackEncoder(nn.Module):
    """Targets learn of one another, then the agent's node and its neighbours query them."""

    # Differs from STAMP: optional. There, what is known of a target reaches the decoder only
    # through the beliefs at all nodes, mixed with those about the other targets.

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        width = config.width
        self.own = nn.Linear(NUM_TRACK_FEATURES + _NUM_OFFSETS, width)
        self.attention = Projections(width, config.num_heads)
        self.targets = Residual(width, config.feed_forward)
        self.offsets = nn.Linear(_NUM_OFFSETS, width)
        self.pair = nn.Linear(width, width)
        self.score = nn.Linear(width, config.num_heads)
        self.softmax = nn.Softmax(dim=3)
        self.out = nn.Linear(2 * width, width)
        self.nodes = Residual(width, config.feed_forward)

    def forward(
        self, features: Tensor, tracks: Tensor, target_mask: Tensor, places: Tensor
    ) -> Tensor:
        """Features of the queried nodes that know how the targets lie to them.

        features:    (B, L, q, d) the agent's node first
        tracks:      (B, L, N, T)
        target_mask: (B, L, N)
        places:      (B, L, q, 2) au of the nodes
        -> (B, L, q, d)
        """
        offsets = _offsets(tracks, places)  # (B, L, q, N, O)
        tokens = torch.relu(self.own(torch.cat([tracks, offsets[:, :, 0]], dim=-1)))
        mask = target_mask[:, :, None, None]
        tokens = self.targets(tokens, self.attention.attend(tokens, tokens, mask))
        pairs = torch.relu(self.offsets(offsets) + tokens[:, :, None])
        pairs = torch.relu(self.pair(pairs))  # (B, L, q, N, d)
        is_there = target_mask[:, :, None, :, None]
        scores = self.score(pairs).masked_fill(~is_there, HIDDEN)
        weights = self.softmax(scores)  # (B, L, q, N, H)
        heads = pairs.reshape(*weights.shape, -1)  # (B, L, q, N, H, d / H)
        chosen = (weights[..., None] * heads).sum(3).flatten(-2)
        total = (pairs * is_there).sum(3) / _MANY
        result: Tensor = self.nodes(features, self.out(torch.cat([chosen, total], dim=-1)))
        return result


def _offsets(tracks: Tensor, places: Tensor) -> Tensor:
    """How targets lie to nodes: last place and expected place, each as offset, distance, nearness.

    tracks: (B, L, N, T)
    places: (B, L, q, 2) au
    -> (B, L, q, N, 8)
    """
    parts = []
    for first in (0, 2):
        offset = tracks[:, :, None, :, first : first + 2] + 0.5 - places[:, :, :, None]
        distance = (offset.square().sum(-1, keepdim=True) + 1e-6).sqrt()
        parts += [offset / 0.3, distance / 0.3, torch.exp(-distance / LEG_AU)]
    return torch.cat(parts, dim=-1)
