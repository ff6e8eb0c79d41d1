"""The network's decoder: from features of the agent's node and its neighbours to a choice."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from dronemon.policy.features import Graphs
from dronemon.policy.layers import LEG_AU, NetworkConfig, Projections, Residual, rows

CLIP = 10.0
"""Logits are CLIP * tanh(...). Source: pointer network of the authors' release."""
NUM_GEOMETRY_FEATURES = 6
"""Numbers that `relative_geometry` gives for each node."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the network thinks at decisions.

    logits: (B, L, k) of the neighbours of the agent's node, -inf where there is none
    value:  (B, L)    expected discounted return
    """

    logits: Tensor
    value: Tensor


class Decoder(nn.Module):
    """The agent's node queries its neighbours; the pointer's scores are the policy.

    Source: paper, section IV-B, "Decoder".
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        num_features = NUM_GEOMETRY_FEATURES if config.geometry else 1
        self.distance = nn.Linear(config.width + num_features, config.width)
        self.attention = Projections(config.width, config.num_heads)
        self.residual = Residual(config.width, config.feed_forward)
        self.pointer_query = nn.Linear(config.width, config.width, bias=False)
        self.pointer_key = nn.Linear(config.width, config.width, bias=False)
        self.value = nn.Linear(config.width, 1)

    def forward(self, features: Tensor, measures: Tensor, mask: Tensor) -> Verdict:
        """Choose among neighbours.

        features: (B, L, 1 + k, d) the agent's node first
        measures: (B, L, 1 + k, m) distance from it along the roadmap, or `relative_geometry`
        mask:     (B, L, k)        true where there is a neighbour
        """
        with torch.autocast(features.device.type, enabled=False):  # logits need their precision
            full = features.to(self.distance.weight.dtype)
            placed = self.distance(torch.cat([full, measures], dim=-1))
            current, neighbours = placed[:, :, :1], placed[:, :, 1:]
            attended = self.attention.attend(current, neighbours, mask[:, :, None, None])
            chosen = self.residual(current, attended)
            scores = self.pointer_query(chosen) @ self.pointer_key(neighbours).transpose(-1, -2)
            logits = CLIP * torch.tanh(scores[:, :, 0] / math.sqrt(placed.shape[-1]))
            return Verdict(
                logits=logits.masked_fill(~mask, -torch.inf), value=self.value(chosen)[:, :, 0, 0]
            )


def relative_geometry(
    distances: Tensor, graphs: Graphs, queried: Tensor, previous: Tensor
) -> Tensor:
    """Where nodes lie, seen from the agent's, and where it comes from; lengths are in legs.

    distances: (B, L, q, 1) au
    queried:   (B, L, q)       the agent's node first
    previous:  (B, L)          where it comes from
    -> (B, L, q, 6) offset, way, last leg, whether it is the previous node
    """
    # Differs from STAMP: optional. The paper's decoder is given the distance alone, in au.
    places = rows(graphs.coordinates, queried)  # (B, L, q, 2)
    offset = places - places[:, :, :1]
    leg = (places[:, :, :1] - rows(graphs.coordinates, previous)[:, :, None]).expand_as(offset)
    is_previous = (queried == previous[..., None])[..., None].to(places.dtype)
    return torch.cat([*(x / LEG_AU for x in (offset, distances, leg)), is_previous], dim=-1)
