"""The paper's network computed the plain way, from the weights of a `PolicyNetwork`: no sharing, no
folded products.

Every decision encodes all of its windows, makes d-wide features of every target, adds the
trajectory-length embedding to the features before the projections, and lets every node of the
roadmap query every other.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from dronemon.policy import Graphs, PolicyNetwork
from dronemon.policy.encoders import TemporalEncoder
from dronemon.policy.layers import Projections
from dronemon.problem import WINDOW_AU

Noted = list[Tensor]
"""Weights of every attention in its turn: target, temporal, spatial, targets, tracks, decoder."""


def naive_attention(
    maps: Projections, query: Tensor, source: Tensor, mask: Tensor, noted: Noted
) -> Tensor:
    """Multi-head attention, head by head; its weights (..., H, n, m) are noted.

    query: (..., n, d); source: (..., m, d); mask: (..., n, m) true where allowed.
    """
    width = query.shape[-1] // maps.num_heads
    heads, weights = [], []
    for head in range(maps.num_heads):
        rows = slice(head * width, (head + 1) * width)
        q, k, v = (
            maps.query(query)[..., rows],
            maps.key(source)[..., rows],
            maps.value(source)[..., rows],
        )
        scores = (q @ k.transpose(-1, -2) / math.sqrt(width)).masked_fill(~mask, -torch.inf)
        weights.append(scores.softmax(-1))
        heads.append(weights[-1] @ v)
    noted.append(torch.stack(weights, dim=-3))
    return maps.out(torch.cat(heads, dim=-1))


def naive_layer(
    layer: nn.Module, query: Tensor, source: Tensor, mask: Tensor, noted: Noted
) -> Tensor:
    """A post-norm transformer layer."""
    residual = layer.residual
    attended = naive_attention(layer.attention, query, source, mask, noted)
    hidden = residual.norm_attended(query + attended)
    return residual.norm_out(hidden + residual.feed_forward(hidden))


def naive_windows(
    frames: Tensor, decision: int, stride: int, count: int, width: int | None = None
) -> list[Tensor]:
    """The windows a decision sees, newest first; of their newest frames only. frames: (L, ...)."""
    ends = [decision - stride * i for i in range(count) if decision - stride * i >= 0]
    return [frames[max(0, end - (width or stride) + 1) : end + 1].mean(0) for end in ends]


def naive_verdict(
    network: PolicyNetwork,
    graphs: Graphs,
    frames: Tensor,
    target_mask: Tensor,
    lengths_au: Tensor,
    nodes: tuple[int, int],
    history: int,
    tracks: Tensor,
    noted: Noted | None = None,
) -> tuple[Tensor, Tensor]:
    """Logits (k,) and value () of the last decision of one episode; its weights are `noted`.

    frames: (L, V, N, 4); target_mask: (N,) always, or (L, N); graphs: of one episode; nodes: the
    agent's, and the one before; tracks: (N, T) of the last decision.
    """
    target_mask = target_mask.expand(len(frames), -1)
    config, noted = network.config, [] if noted is None else noted
    stride = min(config.stride, history)
    count = math.ceil(history / stride) if config.temporal == "attention" else len(frames)
    decision, (current, previous) = len(frames) - 1, nodes
    windows = torch.stack(naive_windows(frames, decision, stride, count))  # (W, V, N, 4)
    known = target_mask.flip(0)[::stride][:count]  # (W, N)
    newest = torch.stack(naive_windows(frames, decision, stride, count, width=1))
    centre, spread = windows.new_tensor([[0.0, 0.9, 0.0, 0.96], [0.12, 0.17, 0.08, 0.06]])
    shown = [windows, newest] if config.newest else [windows]
    kept = 4 if config.predictions else 2
    features = torch.cat([((w - centre) / spread)[..., :kept] for w in shown], dim=-1)
    marks_au = torch.stack(naive_windows(lengths_au, decision, stride, count))
    coordinates = network.target_encoder.coordinates(graphs.coordinates[0])  # (V, d)
    beliefs = network.target_encoder.belief(features)  # (W, V, N, d)
    encoded = naive_layer(
        network.target_encoder,
        coordinates[None, :, None].expand(len(windows), -1, -1, -1),
        beliefs,
        known[:, None, None],
        noted,
    )[:, :, 0]  # (W, V, d)
    if isinstance(network.temporal, TemporalEncoder):
        ages = (lengths_au[-1] - marks_au) / WINDOW_AU
        timed = encoded + network.temporal.length(ages[:, None].to(encoded.dtype))[:, None]
        past = timed.transpose(0, 1)
        everything = torch.ones(1, len(windows), dtype=torch.bool)
        aware = naive_layer(network.temporal, past[:, :1], past, everything, noted)[:, 0]
    else:
        oldest_first = marks_au.flip(0)
        gaps = torch.diff(oldest_first, prepend=oldest_first[:1]) / WINDOW_AU
        timed = encoded.flip(0) + network.temporal.length(gaps[:, None].to(encoded.dtype))[:, None]
        aware = network.temporal.cell(timed.transpose(0, 1))[0][:, -1]
    spatial = network.spatial_encoder
    placed = (aware + spatial.eigenvectors(graphs.eigenvectors[0]))[None]
    related = _related_layer(spatial, placed, graphs, current, noted)[0]
    if config.tracks:
        shown_tracks = tracks[target_mask[-1]]
        related = _tracked(network.track_encoder, related, shown_tracks, graphs, current, noted)
    ways = graphs.distances[0, current][:, None]
    if config.geometry:
        places = graphs.coordinates[0]
        leg = (places[current] - places[previous]).expand_as(places)
        came_from = torch.zeros_like(ways)
        came_from[previous] = 1.0
        ways = torch.cat(
            [(places - places[current]) / 0.1, ways / 0.1, leg / 0.1, came_from], dim=-1
        )
    placed = network.decoder.distance(torch.cat([related, ways], dim=-1))
    neighbours = placed[graphs.neighbours[0, current]]
    mask = graphs.neighbour_mask[0, current]
    chosen = naive_layer(network.decoder, placed[current][None], neighbours, mask[None], noted)[0]
    scores = network.decoder.pointer_key(neighbours) @ network.decoder.pointer_query(chosen)
    logits = 10.0 * torch.tanh(scores / math.sqrt(config.width))
    return logits.masked_fill(~mask, -torch.inf), network.decoder.value(chosen)[0]


def _tracked(
    encoder: nn.Module, nodes: Tensor, tracks: Tensor, graphs: Graphs, here: int, noted: Noted
) -> Tensor:
    """Every node of the roadmap looks at every target. nodes: (V, d); tracks: (N, T)."""
    places = graphs.coordinates[0]

    def lies(track: Tensor, node: int) -> Tensor:
        numbers = []
        for place in (track[:2], track[2:4]):
            offset = place + 0.5 - places[node]
            distance = (offset @ offset + 1e-6).sqrt()
            numbers += [offset / 0.3, distance[None] / 0.3, torch.exp(-distance[None] / 0.1)]
        return torch.cat(numbers)

    own = torch.stack([torch.cat([track, lies(track, here)]) for track in tracks])
    tokens = encoder.own(own).relu()
    everything = torch.ones(len(tokens), len(tokens), dtype=torch.bool)
    mixed = naive_attention(encoder.attention, tokens, tokens, everything, noted)
    layer = encoder.targets
    hidden = layer.norm_attended(tokens + mixed)
    tokens = layer.norm_out(hidden + layer.feed_forward(hidden))
    heads, told, looks = encoder.attention.num_heads, [], []
    for node in range(len(nodes)):
        pairs = torch.stack(
            [
                encoder.pair((encoder.offsets(lies(track, node)) + token).relu()).relu()
                for track, token in zip(tracks, tokens, strict=True)
            ]
        )
        weights = encoder.score(pairs).softmax(0)  # (N, H)
        looks.append(weights.T)
        chosen = [weights[:, head] @ part for head, part in enumerate(pairs.chunk(heads, dim=-1))]
        told.append(torch.cat([*chosen, pairs.sum(0) / 4.0]))
    noted.append(torch.stack(looks, dim=1))  # (H, V, N)
    layer = encoder.nodes
    hidden = layer.norm_attended(nodes + encoder.out(torch.stack(told)))
    return layer.norm_out(hidden + layer.feed_forward(hidden))


def _related_layer(
    spatial: nn.Module, nodes: Tensor, graphs: Graphs, current: int, noted: Noted
) -> Tensor:
    """The spatial encoder, with a key and a value for each pair of nodes. nodes: (1, V, d)."""
    if spatial.ways is None:
        return naive_layer(spatial, nodes, nodes, graphs.node_mask[:, None], noted)
    maps = spatial.attention
    width = nodes.shape[-1] // maps.num_heads
    reaches = nodes.new_tensor(spatial.ways.REACHES_AU)
    distances = graphs.distances[0]
    detours = distances[current][:, None] + distances - distances[current]
    closeness = torch.exp(
        -torch.cat([distances[..., None] / reaches, detours[..., None] / 0.1], dim=-1)
    )  # (V, V, R)
    heads, looks = [], []
    for head in range(maps.num_heads):
        rows = slice(head * width, (head + 1) * width)
        q, k, v = (m(nodes)[0, :, rows] for m in (maps.query, maps.key, maps.value))
        keys = k[None] + closeness @ spatial.ways.key[head].T  # (V, V, e)
        values = v[None] + closeness @ spatial.ways.value[head]
        scores = torch.einsum("ie,ije->ij", q, keys) / math.sqrt(width)
        scores = scores + closeness @ spatial.ways.bias[head]
        looks.append(scores.masked_fill(~graphs.node_mask, -torch.inf).softmax(-1))
        heads.append(torch.einsum("ij,ije->ie", looks[-1], values))
    noted.append(torch.stack(looks)[None])
    residual = spatial.residual
    hidden = residual.norm_attended(nodes + maps.out(torch.cat(heads, dim=-1)))
    return residual.norm_out(hidden + residual.feed_forward(hidden))
