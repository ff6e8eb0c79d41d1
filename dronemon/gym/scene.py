"""What is observed, of episodes and of missions alike, and where an action leads.

B: episodes; V: nodes, the start among them; K: ways to go on from a node; N: targets
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dronemon.types import BoolArray, IntArray

Shown: TypeAlias = dict[str, NDArray[Any]]
"""An observation, by name; of B episodes where all arrays begin with B."""


class Scene:
    """The roadmaps of B episodes, with room for the same number of ways to go on from each node.

    nodes_au:   (B, V, 2) float32 au
    neighbours: (B, V, k) int64 as in `Roadmap`, the node itself first
    is_move:    (B, V, k) where they lead to another node
    num_ways:   K, at least k - 1
    """

    def __init__(
        self,
        nodes_au: NDArray[np.float32],
        neighbours: IntArray,
        is_move: BoolArray,
        num_ways: int,
    ) -> None:
        self._nodes_au = nodes_au
        self._rows = np.arange(len(nodes_au))
        itself = np.arange(nodes_au.shape[1])[:, None]
        ways = np.where(is_move, neighbours, itself)[:, :, 1:]
        spare = np.broadcast_to(itself, (*ways.shape[:2], num_ways - ways.shape[2]))
        self._ways = np.concatenate([ways, spare], axis=2)  # (B, V, K)

    def show(
        self,
        *,
        node: IntArray,
        position_au: NDArray[Any],
        time_au: NDArray[Any],
        belief: NDArray[Any],
        target_mask: NDArray[Any],
        tracks: NDArray[Any],
    ) -> Shown:
        """The observation, in new arrays; of what is not given here docs/laboratory.md tells.

        node: (B,); position_au: (B, 2); time_au: (B,); belief: (B, V, N, 4); target_mask: (B, N);
        tracks: (B, N, T)
        """
        is_other = self._ways[self._rows, node] != node[:, None]
        return {
            "position_au": position_au.astype(np.float32),
            "time_au": time_au.astype(np.float32)[:, None],
            "nodes_au": self._nodes_au.copy(),
            "neighbours": self._ways.copy(),
            "node": node.copy(),
            "neighbour_mask": is_other.astype(np.int8),
            "belief": belief.copy(),
            "target_mask": target_mask.astype(np.int8),
            "tracks": tracks.copy(),
        }

    def follow(self, node: IntArray, actions: IntArray) -> IntArray:
        """Nodes to which actions lead: of m ways, action a is that of number a mod m.

        node, actions: (B,) -> (B,)
        """
        ways = self._ways[self._rows, node]
        count = (ways != node[:, None]).sum(axis=1)
        reached: IntArray = ways[self._rows, actions % count]
        return reached


def line(shown: Shown, episode: int) -> Shown:
    """What is observed in one of the episodes."""
    return {name: array[episode] for name, array in shown.items()}
