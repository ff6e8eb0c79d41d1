"""The network's shape, and the parts that its encoders and its decoder are made of."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from dronemon.errors import PolicyError

LEG_AU = 0.1
"""About the distance to a neighbour."""
HIDDEN = -1e4
"""Score of what must not be seen; finite, for there may be nothing else."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkConfig:
    """Shape of the network; the defaults are the paper's, and the last four are not in the paper.

    predictions: give beliefs a little later, too (the paper's ablation "w/o" does not)
    temporal:    how history is read
    newest:      show windows' newest frames beside their means
    ways:        tell nodes how far apart they are along the roadmap
    geometry:    tell the decoder where neighbours lie and where the agent comes from
    tracks:      show each target's own track to them
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
        for name in ("width", "num_heads", "feed_forward", "num_eigenvectors", "stride"):
            if getattr(self, name) < 1:
                raise PolicyError(f"{name} is {getattr(self, name)}; it must be at least 1")
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


class Projections(nn.Module):
    """Linear maps of multi-head attention, without bias. Source: paper, equation 3.

    The weights are what `softmax` gives for scores (..., H, n, m); `policy.explain` listens there.
    """

    def __init__(self, width: int, num_heads: int) -> None:
        super().__init__()
        self.num_heads = num_heads
        self.query = nn.Linear(width, width, bias=False)
        self.key = nn.Linear(width, width, bias=False)
        self.value = nn.Linear(width, width, bias=False)
        self.out = nn.Linear(width, width, bias=False)
        self.softmax = nn.Softmax(dim=-1)

    def heads(self, features: Tensor) -> Tensor:
        """(..., n, d) -> (..., H, n, d / H)."""
        split = features.view(*features.shape[:-1], self.num_heads, -1)
        return split.transpose(-3, -2)

    def join(self, mixed: Tensor) -> Tensor:
        """What all heads found, put out. (..., H, n, d / H) -> (..., n, d)."""
        out: Tensor = self.out(mixed.transpose(-3, -2).flatten(-2))
        return out

    def attend(self, asking: Tensor, asked: Tensor, mask: Tensor) -> Tensor:
        """What (..., n, d) find in (..., m, d). mask: (..., m) true where seen -> (..., n, d)."""
        query, key = self.heads(self.query(asking)), self.heads(self.key(asked))
        scores = query @ key.transpose(-1, -2) / math.sqrt(query.shape[-1])
        weights = self.softmax(scores.masked_fill(~mask, HIDDEN))
        return self.join(weights @ self.heads(self.value(asked)))

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
        """Query features and what attention gave for them, both (..., d) -> (..., d)."""
        # Differs from STAMP: the norms follow the sums, as the paper says; the release puts them
        # before.
        hidden = self.norm_attended(query + attended)
        result: Tensor = self.norm_out(hidden + self.feed_forward(hidden))
        return result


def rows(table: Tensor, index: Tensor) -> Tensor:
    """Rows of each episode's table, (B, V, ...) by index (B, ...) -> (B, ..., ...)."""
    episodes = torch.arange(len(table), device=table.device)
    return table[episodes.view(-1, *[1] * (index.dim() - 1)), index]


def take(features: Tensor, index: Tensor) -> Tensor:
    """Features of some nodes, (B, L, V, d) by index (B, L, q) -> (B, L, q, d)."""
    return features.gather(2, index[..., None].expand(-1, -1, -1, features.shape[-1]))
