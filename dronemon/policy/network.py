"""The paper's spatio-temporal attention network, arranged so that nothing is computed twice.

Source: paper, section IV-B. Three identities, all exact, make it cheap; the reference in
tests/policy computes without them.

Windows are shared. A window's feature h depends on the decision that sees it only through the
trajectory-length embedding W_L (a - m) + b, where a is the length flown at the decision and m the
window's own mark. So its key is W_K (h + b) - m W_K W_L + a W_K W_L, whose last term adds the same
to every score of a query and leaves the softmax as it is; the same term of its value adds
a W_V W_L to the result. Keys and values are made once and serve every later decision of the phase.

Beliefs are narrow. Keys and values of the target encoder are linear in F = 4 numbers, so scores
and results go through (d, F) products of the weights, and no target gets a feature of width d.

Only the neighbourhood is decoded. The decoder reads the agent's node and its neighbours, so only
these query the spatial encoder.

In the paper   here
h^c            `place` in TargetEncoder
h^{g_i}        never made; W_b x_i + b_b with `TargetEncoder.belief`
h^G            `encoded`
h^L            `TemporalEncoder.length` of an age
h^{TG}         `aware`, then `nodes`
h^E            `SpatialEncoder.eigenvectors` of lambda
h^{STG}        what `SpatialEncoder` gives, at the queried nodes
alpha          softmax of `Verdict.logits`
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn.functional import pad, scaled_dot_product_attention

from dronemon.errors import PolicyError
from dronemon.policy.features import Graphs, Segment, num_windows, pool_windows
from dronemon.policy.tracks import NUM_TRACK_FEATURES

CLIP = 10.0
"""Logits are CLIP * tanh(...). Source: pointer network of the authors' release."""
FEATURE_MEAN = (0.0, 0.9, 0.0, 0.96)
FEATURE_SPREAD = (0.12, 0.17, 0.08, 0.06)
"""About the mean and the standard deviation of mu and sigma, now and a little later, as flown.

As they are, they hardly move a new network; bfloat16's spacing at sigma' is 7 % of its spread.
"""
LEG_AU = 0.1
"""About the distance to a neighbour."""
_NUM_OFFSETS = 8
_MANY = 4.0
"""Targets over whose number the sum of what they say is divided, to be of order one."""
_HIDDEN = -1e4
"""Score of what must not be seen; finite, for there may be nothing else."""
NUM_MEASURES = 6
"""Numbers that `_measures` gives for each node."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkConfig:
    """Shape of the network; the defaults are the paper's.

    predictions: give beliefs a little later, too (the paper's ablation "w/o" does not); temporal:
    how history is read. The rest is ours. newest: show windows' newest frames beside their means;
    ways: tell nodes how far apart they are along the roadmap; geometry: tell the decoder where
    neighbours lie and where the agent comes from; tracks: show each target's own track to them.
    """

    width: int = 128
    num_heads: int = 4
    feed_forward: int = 512
    num_eigenvectors: int = 32
    stride: int = 5
    predictions: bool = True
    temporal: Literal["attention", "lstm"] = "attention"
    newest: bool = False
    ways: bool = False
    geometry: bool = False
    tracks: bool = False

    def __post_init__(self) -> None:
        if self.width % self.num_heads:
            raise PolicyError(
                f"width {self.width} is no multiple of {self.num_heads} heads; choose one that is"
            )
        if self.temporal not in ("attention", "lstm"):
            raise PolicyError(f"temporal is {self.temporal!r}; it can be 'attention' or 'lstm'")

    @property
    def num_features(self) -> int:
        """F."""
        return (4 if self.predictions else 2) * (2 if self.newest else 1)

    def stride_for(self, history: int) -> int:
        """s, or less where the history is shorter than one window."""
        return min(self.stride, history)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the network thinks at decisions.

    logits: (B, L, k) of the neighbours of the agent's node, -inf where there is none; value: (B, L)
    expected discounted return
    """

    logits: Tensor
    value: Tensor


class Projections(nn.Module):
    """Linear maps of multi-head attention, without bias. Source: paper, equation 3."""

    def __init__(self, width: int, num_heads: int) -> None:
        super().__init__()
        self.num_heads = num_heads
        self.query = nn.Linear(width, width, bias=False)
        self.key = nn.Linear(width, width, bias=False)
        self.value = nn.Linear(width, width, bias=False)
        self.out = nn.Linear(width, width, bias=False)

    def heads(self, features: Tensor) -> Tensor:
        """(..., n, d) -> (..., H, n, d / H)."""
        split = features.view(*features.shape[:-1], self.num_heads, -1)
        return split.transpose(-3, -2)

    def split(self, weight: Tensor) -> Tensor:
        """Rows of a weight by head. (d, ...) -> (H, d / H, ...)."""
        return weight.view(self.num_heads, -1, *weight.shape[1:])


class Residual(nn.Module):
    """The rest of a transformer layer: residual and norm, feed-forward, residual and norm."""

    def __init__(self, width: int, feed_forward: int) -> None:
        super().__init__()
        self.norm_attended = nn.LayerNorm(width)
        self.feed_forward = nn.Sequential(
            nn.Linear(width, feed_forward), nn.ReLU(), nn.Linear(feed_forward, width)
        )
        self.norm_out = nn.LayerNorm(width)

    def forward(self, query: Tensor, attended: Tensor) -> Tensor:
        """Query features and what attention gave for them. Both: (..., d) -> (..., d)."""
        # Differs from STAMP: the norms follow the sums, as the paper says; the release puts them
        # before.
        hidden = self.norm_attended(query + attended)
        result: Tensor = self.norm_out(hidden + self.feed_forward(hidden))
        return result


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

        coordinates: (B, V, 2); windows: (B, P, V, n, N, F), P phases of n windows; target_mask: (B,
        N) -> (B, P, V, n, d)
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
        is_unknown = ~target_mask[:, None, None, None, None]
        # A finite mask, so that the softmax over no known target at all is a number; it counts 0.
        weights = scores.masked_fill(is_unknown, -1e9).softmax(-1).masked_fill(is_unknown, 0.0)
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

        encoded: (..., n, d), the newest window at n decisions; projected: of the m windows of the
        past, each (..., H, m, d / H); flown: (..., n) at the decisions; marks: of the newest
        windows (..., n) and of the past (..., m); lengths count from any one origin; mask: (n, m),
        true where a decision sees a window -> (..., n, d)
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
        weights = scores.softmax(-1)
        age = flown[..., None, :, None] - (weights * past).sum(-1, keepdim=True)
        mixed = weights @ values + age * maps.split(maps.value(rate))[:, None]
        attended = maps.out(mixed.transpose(-3, -2).flatten(-2))
        result: Tensor = self.residual(features, attended)
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

        encoded: (..., n, d), successive windows of a phase; gaps: (..., n), length flown between
        each and the one before it, in units of `WINDOW_AU` -> (..., n, d), state of two (1,
        ..., d)
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

        nodes: (B, L, V, d); queried: (B, L, q), the agent's node first -> (B, L, q, d)
        """
        features = nodes + self.eigenvectors(graphs.eigenvectors)[:, None]
        asking, maps = _take(features, queried), self.attention
        query = maps.heads(maps.query(asking))  # (B, L, H, q, d / H)
        query = query / math.sqrt(query.shape[-1])
        scores = query @ maps.heads(maps.key(features)).transpose(-1, -2)
        if self.ways is not None:
            closeness = self.ways.closeness(_rows(graphs.distances, queried), queried)
            scores = scores + self.ways.scores(query, closeness)
        scores = scores.masked_fill(~graphs.node_mask[:, None, None, None], -torch.inf)
        weights = scores.softmax(-1)  # (B, L, H, q, V)
        mixed = weights @ maps.heads(maps.value(features))
        if self.ways is not None:
            mixed = mixed + self.ways.values(weights, closeness)
        result: Tensor = self.residual(asking, maps.out(mixed.transpose(-3, -2).flatten(-2)))
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

        distances: (B, L, q, V) from the queried nodes, the agent's first; queried: (B, L, q) -> (B,
        L, q, V, R)
        """
        direct = distances[:, :, 0]
        detours = direct.gather(2, queried)[..., None] + distances - direct[:, :, None]
        falling = [distances / reach_au for reach_au in self.REACHES_AU]
        return torch.exp(-torch.stack([*falling, detours / self.DETOUR_AU], dim=-1))

    def scores(self, query: Tensor, closeness: Tensor) -> Tensor:
        """What relative keys add. query: (B, L, H, q, e); closeness: (B, L, q, V, R)."""
        pull = query @ self.key + self.bias[:, None]  # (B, L, H, q, R)
        return (closeness @ pull.permute(0, 1, 3, 4, 2)).permute(0, 1, 4, 2, 3)

    def values(self, weights: Tensor, closeness: Tensor) -> Tensor:
        """What relative values add. weights: (B, L, H, q, V) -> (B, L, H, q, e)."""
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
        self.out = nn.Linear(2 * width, width)
        self.nodes = Residual(width, config.feed_forward)

    def forward(
        self, features: Tensor, tracks: Tensor, target_mask: Tensor, places: Tensor
    ) -> Tensor:
        """Features of the queried nodes that know how the targets lie to them.

        features: (B, L, q, d), the agent's node first; tracks: (B, L, N, T); target_mask: (B, N);
        places: (B, L, q, 2) of the nodes -> (B, L, q, d)
        """
        offsets = _offsets(tracks, places)  # (B, L, q, N, O)
        tokens = torch.relu(self.own(torch.cat([tracks, offsets[:, :, 0]], dim=-1)))
        maps, mask = self.attention, target_mask[:, None, None, None]
        mixed = scaled_dot_product_attention(
            maps.heads(maps.query(tokens)),
            maps.heads(maps.key(tokens)),
            maps.heads(maps.value(tokens)),
            attn_mask=torch.where(mask, 0.0, _HIDDEN).to(tokens.dtype),
        )
        tokens = self.targets(tokens, maps.out(mixed.transpose(-3, -2).flatten(-2)))
        pairs = torch.relu(self.offsets(offsets) + tokens[:, :, None])
        pairs = torch.relu(self.pair(pairs))  # (B, L, q, N, d)
        is_there = target_mask[:, None, None, :, None]
        weights = self.score(pairs).masked_fill(~is_there, _HIDDEN).softmax(3)
        heads = pairs.reshape(*weights.shape, -1)  # (B, L, q, N, H, d / H)
        chosen = (weights[..., None] * heads).sum(3).flatten(-2)
        total = (pairs * is_there).sum(3) / _MANY
        result: Tensor = self.nodes(features, self.out(torch.cat([chosen, total], dim=-1)))
        return result


def _offsets(tracks: Tensor, places: Tensor) -> Tensor:
    """How targets lie to nodes: last place and expected place, each as offset, distance, nearness.

    tracks: (B, L, N, T); places: (B, L, q, 2) -> (B, L, q, N, 8)
    """
    parts = []
    for first in (0, 2):
        offset = tracks[:, :, None, :, first : first + 2] + 0.5 - places[:, :, :, None]
        distance = (offset.square().sum(-1, keepdim=True) + 1e-6).sqrt()
        parts += [offset / 0.3, distance / 0.3, torch.exp(-distance / LEG_AU)]
    return torch.cat(parts, dim=-1)


class Decoder(nn.Module):
    """The agent's node queries its neighbours; the pointer's scores are the policy.

    Source: paper, section IV-B, "Decoder".
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        num_measures = NUM_MEASURES if config.geometry else 1
        self.distance = nn.Linear(config.width + num_measures, config.width)
        self.attention = Projections(config.width, config.num_heads)
        self.residual = Residual(config.width, config.feed_forward)
        self.pointer_query = nn.Linear(config.width, config.width, bias=False)
        self.pointer_key = nn.Linear(config.width, config.width, bias=False)
        self.value = nn.Linear(config.width, 1)

    def forward(self, features: Tensor, measures: Tensor, mask: Tensor) -> Verdict:
        """Choose among neighbours.

        features: (B, L, 1 + k, d), the agent's node first; measures: (B, L, 1 + k, m), the distance
        from it along the roadmap or what `_measures` gives; mask: (B, L, k)
        """
        with torch.autocast(features.device.type, enabled=False):  # logits need their precision
            full = features.to(self.distance.weight.dtype)
            placed = self.distance(torch.cat([full, measures], dim=-1))
            current, neighbours = placed[:, :, :1], placed[:, :, 1:]
            maps = self.attention
            mixed = scaled_dot_product_attention(
                maps.heads(maps.query(current)),
                maps.heads(maps.key(neighbours)),
                maps.heads(maps.value(neighbours)),
                attn_mask=mask[:, :, None, None],
            )
            chosen = self.residual(current, maps.out(mixed.transpose(-3, -2).flatten(-2)))
            scores = self.pointer_query(chosen) @ self.pointer_key(neighbours).transpose(-1, -2)
            logits = CLIP * torch.tanh(scores[:, :, 0] / math.sqrt(placed.shape[-1]))
            return Verdict(
                logits=logits.masked_fill(~mask, -torch.inf), value=self.value(chosen)[:, :, 0, 0]
            )


class PolicyNetwork(nn.Module):
    """The whole network: `forward` takes whole episodes, `History` one decision after another."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.target_encoder = TargetEncoder(config)
        self.temporal: TemporalEncoder | TemporalMemory = (
            TemporalEncoder(config) if config.temporal == "attention" else TemporalMemory(config)
        )
        self.spatial_encoder = SpatialEncoder(config)
        self.track_encoder = TrackEncoder(config) if config.tracks else None
        self.decoder = Decoder(config)

    def forward(self, segment: Segment, history: int) -> Verdict:
        """All decisions of the episodes at once, each seeing the last `history` frames."""
        length = segment.frames.shape[1]
        stride = self.config.stride_for(history)
        windows = _to_phases(self.windows(segment.frames, stride), stride).transpose(2, 3)
        encoded = self.target_encoder(segment.graphs.coordinates, windows, segment.target_mask)
        flown = _to_phases(segment.flown, stride)[:, :, None]  # (B, P, 1, n)
        marks = _to_phases(pool_windows(segment.flown, stride), stride)[:, :, None]
        if isinstance(self.temporal, TemporalMemory):
            gaps = torch.diff(marks, prepend=marks[..., :1]).expand(encoded.shape[:-1])
            aware, _ = self.temporal(encoded, gaps)
        else:
            mask = _band(encoded.shape[3], num_windows(history, stride), encoded.device)
            aware = self.temporal(
                encoded, self.temporal.project(encoded), flown, (marks, marks), mask
            )
        nodes = aware.permute(0, 3, 1, 2, 4).flatten(1, 2)[:, :length]  # (B, L, V, d)
        previous = torch.cat([segment.nodes[:, :1], segment.nodes[:, :-1]], dim=1)
        return self.decide(
            nodes, segment.graphs, segment.nodes, previous, segment.tracks, segment.target_mask
        )

    def windows(self, frames: Tensor, stride: int, first: int = 0) -> Tensor:
        """What is seen at each decision from the `first` on, of order one.

        frames: (B, L, V, N, 4) belief features -> (B, L - first, V, N, F)
        """
        # Differs from STAMP: a linear map follows, so the network can be the same as without this;
        # learning and bfloat16 are not.
        scaled = (frames - frames.new_tensor(FEATURE_MEAN)) / frames.new_tensor(FEATURE_SPREAD)
        shown = scaled if self.config.predictions else scaled[..., :2]
        pooled = pool_windows(shown, stride, first)
        # Differs from STAMP: optional. The mean alone shows what just changed a fifth as strong.
        return torch.cat([pooled, shown[:, first:]], dim=-1) if self.config.newest else pooled

    def decide(
        self,
        nodes: Tensor,
        graphs: Graphs,
        current: Tensor,
        previous: Tensor,
        tracks: Tensor,
        target_mask: Tensor,
    ) -> Verdict:
        """From time-aware node features to the policy.

        nodes: (B, L, V, d); current: (B, L) the agent's nodes; previous: (B, L) those before them,
        at the start of an episode the same; tracks: (B, L, N, T); target_mask: (B, N)
        """
        neighbours = _rows(graphs.neighbours, current)  # (B, L, k)
        queried = torch.cat([current[..., None], neighbours], dim=-1)
        distances = _rows(graphs.distances, current).gather(2, queried)[..., None]
        features = self.spatial_encoder(nodes, graphs, queried)
        if self.track_encoder is not None:
            places = _rows(graphs.coordinates, queried)
            features = self.track_encoder(features, tracks, target_mask, places)
        verdict: Verdict = self.decoder(
            features,
            _measures(distances, graphs, queried, previous) if self.config.geometry else distances,
            _rows(graphs.neighbour_mask, current),
        )
        return verdict


def _measures(distances: Tensor, graphs: Graphs, queried: Tensor, previous: Tensor) -> Tensor:
    """Where nodes lie, seen from the agent's, and where it comes from; lengths are in legs.

    distances: (B, L, q, 1) au; queried: (B, L, q), the agent's node first; previous: (B, L) -> (B,
    L, q, 6) offset, way, last leg, whether it is the previous node
    """
    # Differs from STAMP: optional. The paper's decoder is given the distance alone, in au.
    places = _rows(graphs.coordinates, queried)  # (B, L, q, 2)
    offset = places - places[:, :, :1]
    leg = (places[:, :, :1] - _rows(graphs.coordinates, previous)[:, :, None]).expand_as(offset)
    is_previous = (queried == previous[..., None])[..., None].to(places.dtype)
    return torch.cat([*(x / LEG_AU for x in (offset, distances, leg)), is_previous], dim=-1)


def _rows(table: Tensor, index: Tensor) -> Tensor:
    """Rows of each episode's table. table: (B, V, ...); index: (B, ...) -> (B, ..., ...)."""
    episodes = torch.arange(len(table), device=table.device)
    return table[episodes.view(-1, *[1] * (index.dim() - 1)), index]


def _take(features: Tensor, index: Tensor) -> Tensor:
    """Features of some nodes. features: (B, L, V, d); index: (B, L, q) -> (B, L, q, d)."""
    return features.gather(2, index[..., None].expand(-1, -1, -1, features.shape[-1]))


def _to_phases(values: Tensor, stride: int) -> Tensor:
    """Every `stride`-th decision side by side; the end is padded with zeros.

    (B, L, ...) -> (B, stride, n, ...).
    """
    short = -values.shape[1] % stride
    padded = pad(values, [0, 0] * (values.dim() - 2) + [0, short])
    phased: Tensor = padded.view(len(values), -1, stride, *values.shape[2:]).transpose(1, 2)
    return phased


def _band(length: int, width: int, device: torch.device) -> Tensor:
    """Which windows of its phase a decision sees: its own and the width - 1 before.

    -> (length, length) bool.
    """
    ones = torch.ones(length, length, dtype=torch.bool, device=device)
    return ones.tril().triu(1 - width)
