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

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from dronemon.policy.decoder import Decoder, Verdict, relative_geometry
from dronemon.policy.encoders import (
    SpatialEncoder,
    TargetEncoder,
    TemporalEncoder,
    TemporalMemory,
    TrackEncoder,
)
from dronemon.policy.features import Graphs, Segment, num_windows, pool_windows
from dronemon.policy.layers import NetworkConfig, rows

FEATURE_MEAN = (0.0, 0.9, 0.0, 0.96)
FEATURE_SPREAD = (0.12, 0.17, 0.08, 0.06)
"""About the mean and the standard deviation of mu and sigma, now and a little later, as flown.

As they are, they hardly move a new network; bfloat16's spacing at sigma' is 7 % of its spread.
"""


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

    def forward(self, segment: Segment, history: int, phase: int | None = None) -> Verdict:
        """All decisions of the episodes at once, each seeing the last `history` frames.

        phase: judge only every stride-th decision, from this one on, at a stride-th of the cost
        """
        stride = self.config.stride_for(history)
        first, step, num_phases = (0, 1, stride) if phase is None else (phase, stride, 1)
        chosen = slice(first, None, step)
        windows = self.windows(segment.frames, stride, first, step)
        known = _to_phases(segment.target_mask[:, chosen], num_phases)
        encoded = self.target_encoder(
            segment.graphs.coordinates, _to_phases(windows, num_phases).transpose(2, 3), known
        )
        # (B, P, 1, n)
        flown = _to_phases(segment.flown[:, chosen], num_phases)[:, :, None]
        marks = pool_windows(segment.flown, stride, first, step)
        marks = _to_phases(marks, num_phases)[:, :, None]
        if isinstance(self.temporal, TemporalMemory):
            gaps = torch.diff(marks, prepend=marks[..., :1]).expand(encoded.shape[:-1])
            aware, _ = self.temporal(encoded, gaps)
        else:
            mask = _band(encoded.shape[3], num_windows(history, stride), encoded.device)
            aware = self.temporal(
                encoded, self.temporal.project(encoded), flown, (marks, marks), mask
            )
        previous = torch.cat([segment.nodes[:, :1], segment.nodes[:, :-1]], dim=1)[:, chosen]
        nodes = aware.permute(0, 3, 1, 2, 4).flatten(1, 2)[:, : previous.shape[1]]  # (B, L, V, d)
        return self.decide(
            nodes,
            segment.graphs,
            segment.nodes[:, chosen],
            previous,
            segment.tracks[:, chosen],
            segment.target_mask[:, chosen],
        )

    def windows(self, frames: Tensor, stride: int, first: int = 0, step: int = 1) -> Tensor:
        """What is seen at decisions first, first + step, ... of L, of order one.

        frames: (B, L, V, N, 4) belief features -> (B, n, V, N, F)
        """
        # Differs from STAMP: a linear map follows, so the network can be the same as without this;
        # learning and bfloat16 are not.
        mean, spread = frames.new_tensor(FEATURE_MEAN), frames.new_tensor(FEATURE_SPREAD)
        parts = [pool_windows(frames, stride, first, step)]
        if self.config.newest:
            # Differs from STAMP: optional. The mean shows what just changed a fifth as strong.
            parts.append(frames[:, first::step])
        size = 4 if self.config.predictions else 2
        return torch.cat([((part - mean) / spread)[..., :size] for part in parts], dim=-1)

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

        nodes:       (B, L, V, d)
        current:     (B, L)       the agent's nodes
        previous:    (B, L)       those before them, at the start of an episode the same
        tracks:      (B, L, N, T)
        target_mask: (B, L, N)
        """
        neighbours = rows(graphs.neighbours, current)  # (B, L, k)
        queried = torch.cat([current[..., None], neighbours], dim=-1)
        distances = rows(graphs.distances, current).gather(2, queried)[..., None]
        features = self.spatial_encoder(nodes, graphs, queried)
        if self.track_encoder is not None:
            places = rows(graphs.coordinates, queried)
            features = self.track_encoder(features, tracks, target_mask, places)
        verdict: Verdict = self.decoder(
            features,
            relative_geometry(distances, graphs, queried, previous)
            if self.config.geometry
            else distances,
            rows(graphs.neighbour_mask, current),
        )
        return verdict


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
