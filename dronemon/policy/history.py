"""The network's memory between decisions: each pooled window is encoded once.

Source: paper, section IV-B; the identities are told in `policy.network`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dronemon.policy.decoder import Verdict
from dronemon.policy.encoders import TemporalEncoder, TemporalMemory
from dronemon.policy.features import Graphs, num_windows, pool_windows
from dronemon.policy.network import PolicyNetwork
from dronemon.problem import WINDOW_AU


@dataclass(slots=True)
class _Phase:
    """Every stride-th window: keys, values (B, 1, V, H, T', d / H), marks (B, T'); or an LSTM."""

    keys: Tensor
    values: Tensor
    marks_au: Tensor
    count: int = 0
    state: tuple[Tensor, Tensor] | None = None


class History:
    """B episodes that decide in step; memory stays the same however long they last."""

    def __init__(self, network: PolicyNetwork, graphs: Graphs, history: int) -> None:
        config = network.config
        self.network = network
        self.graphs = graphs
        self._stride = config.stride_for(history)
        ring = num_windows(history, self._stride) if config.temporal == "attention" else 1
        heads = (config.num_heads, ring, config.width // config.num_heads)
        shape = (*graphs.coordinates.shape[:2], *heads)
        self._phases = [
            _Phase(
                keys=graphs.coordinates.new_zeros(shape)[:, None],
                values=graphs.coordinates.new_zeros(shape)[:, None],
                marks_au=graphs.coordinates.new_zeros(shape[0], ring, dtype=torch.float64),
            )
            for _ in range(self._stride)
        ]
        self._frames: list[Tensor] = []
        self._lengths_au: list[Tensor] = []
        self._node: Tensor | None = None
        self.num_decisions = 0

    def windows(self) -> tuple[Tensor, Tensor]:
        """The windows that the newest decision's attention saw: slots (T',), marks (B, T') in au.

        slots: where each stands among the weights of `TemporalEncoder`; marks: the length flown
        at each. Both are in the windows' order, oldest first.
        """
        phase = self._phases[(self.num_decisions - 1) % self._stride]
        size = phase.marks_au.shape[1]
        slots = torch.arange(max(0, phase.count - size), phase.count) % size
        return slots, phase.marks_au[:, slots]

    @torch.no_grad()
    def decide(
        self, frame: Tensor, target_mask: Tensor, length_au: Tensor, current: Tensor, tracks: Tensor
    ) -> Verdict:
        """Take in the newest frame and judge the agent's next step.

        frame:       (B, V, N, 4) belief features, where N may grow
        target_mask: (B, N)
        length_au:   (B,) float64 flown so far
        current:     (B,) int64   the agent's node
        tracks:      (B, N, T)
        -> logits (B, 1, k), value (B, 1)
        """
        known = [_widened(f, frame.shape[2]) for f in self._frames]
        self._frames = [*known, frame][-self._stride :]
        self._lengths_au = [*self._lengths_au, length_au.double()][-self._stride :]
        last = len(self._frames) - 1
        window = self.network.windows(torch.stack(self._frames, dim=1), self._stride, last)
        mark_au = pool_windows(torch.stack(self._lengths_au, dim=1), self._stride, last)[:, 0]
        encoded = self.network.target_encoder(
            self.graphs.coordinates, window[:, :, :, None], target_mask[:, None, None]
        )
        phase = self._phases[self.num_decisions % self._stride]
        self.num_decisions += 1
        if isinstance(self.network.temporal, TemporalEncoder):
            aware = self._attend(self.network.temporal, phase, encoded, length_au, mark_au)
        else:
            aware = self._carry(self.network.temporal, phase, encoded, mark_au)
        previous = current if self._node is None else self._node
        self._node = current
        return self.network.decide(
            aware[:, :, :, 0],
            self.graphs,
            current[:, None],
            previous[:, None],
            tracks[:, None],
            target_mask[:, None],
        )

    def _attend(
        self,
        encoder: TemporalEncoder,
        phase: _Phase,
        encoded: Tensor,
        length_au: Tensor,
        mark_au: Tensor,
    ) -> Tensor:
        """Put the newest window into its ring, then read the ring; lengths count back from now."""
        slot = phase.count % phase.keys.shape[-2]
        keys, values = encoder.project(encoded)
        phase.keys[..., slot, :], phase.values[..., slot, :] = keys[..., 0, :], values[..., 0, :]
        phase.marks_au[:, slot] = mark_au
        phase.count += 1
        filled = min(phase.count, phase.keys.shape[-2])
        since = (phase.marks_au[:, :filled] - length_au[:, None]) / WINDOW_AU
        marks = since.to(encoded.dtype)[:, None, None]
        aware: Tensor = encoder(
            encoded,
            (phase.keys[..., :filled, :], phase.values[..., :filled, :]),
            torch.zeros_like(marks[..., :1]),
            (marks[..., slot : slot + 1], marks),
        )
        return aware

    def _carry(
        self, memory: TemporalMemory, phase: _Phase, encoded: Tensor, mark_au: Tensor
    ) -> Tensor:
        """Feed the newest window to its phase's LSTM."""
        since_au = mark_au - (phase.marks_au[:, 0] if phase.count else mark_au)
        gaps = (since_au / WINDOW_AU).to(encoded.dtype)[:, None, None, None]
        aware: Tensor
        aware, phase.state = memory(encoded, gaps.expand(encoded.shape[:-1]), phase.state)
        phase.marks_au[:, 0] = mark_au
        phase.count += 1
        return aware


def _widened(frame: Tensor, num_targets: int) -> Tensor:
    """An older frame with prior beliefs about targets unknown then: mean 0, deviation 1.

    (B, V, n, 4).
    """
    missing = num_targets - frame.shape[2]
    if missing <= 0:
        return frame
    unknown = frame.new_tensor([0.0, 1.0, 0.0, 1.0])
    return torch.cat([frame, unknown.expand(*frame.shape[:2], missing, -1)], dim=2)
