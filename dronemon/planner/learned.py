"""The learned planner: an attention network chooses the next roadmap node, greedily.

The network is the paper's, with or without what is ours (`NetworkConfig`), as its checkpoint says.

Source: paper, section IV. Between decisions it keeps its encoded windows, so that each decision
encodes one.
"""

from __future__ import annotations

import numpy as np
import torch

from dronemon.planner.planner import Briefing, Snapshot, Waypoint
from dronemon.policy import (
    DEFAULT_HISTORY,
    Checkpoint,
    Graphs,
    History,
    Tracks,
    belief_features,
    find_checkpoint,
    frame_points,
    load_checkpoint,
)
from dronemon.roadmap import Roadmap, laplacian_encoding
from dronemon.sightings import Sightings


class LearnedPlanner:
    """Flies a trained policy network over the roadmap."""

    name = "stamp"

    def __init__(self, checkpoint: Checkpoint, *, history: int = DEFAULT_HISTORY) -> None:
        self._network = checkpoint.network
        self._history = history

    @classmethod
    def load(cls, checkpoint: str | None = None) -> LearnedPlanner:
        """The planner of a checkpoint's path or name; of the shipped one for None.

        Raises CheckpointMismatch.
        """
        return cls(load_checkpoint(find_checkpoint(checkpoint)))

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        """Forget the last mission's history and encode the new roadmap."""
        num_eigenvectors = self._network.config.num_eigenvectors
        self._graphs = Graphs.of(
            roadmap.nodes_au,
            laplacian_encoding(roadmap, num_eigenvectors),
            roadmap.neighbours,
            roadmap.distance_au,
        )
        self._memory = History(self._network, self._graphs, self._history)
        self._tracks = Tracks(1, briefing.num_targets)
        self._num_read = 0
        priors_au = torch.as_tensor(briefing.priors_au.reshape(1, -1, 2))
        is_placed = priors_au.isfinite().all(-1)
        self._tracks.add_prior(is_placed, priors_au)

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """The neighbour with the greatest logit; details hold all logits and the value."""
        node = snapshot.node if snapshot.node is not None else _nearest_node(snapshot)
        frame, target_mask = self._believe(snapshot)
        time_au = torch.tensor([snapshot.time_au], dtype=torch.float64)
        verdict = self._memory.decide(
            frame,
            target_mask,
            time_au,
            torch.tensor([node]),
            self._follow(snapshot.sightings, time_au, target_mask.shape[1]),
        )
        logits = verdict.logits[0, 0]
        allowed = self._graphs.neighbour_mask[0, node]
        neighbours = self._graphs.neighbours[0, node]
        chosen = int(neighbours[logits.argmax()])
        return Waypoint(
            position_au=snapshot.roadmap.nodes_au[chosen],
            node=chosen,
            details={
                "neighbours": neighbours[allowed].tolist(),
                "logits": logits[allowed].tolist(),
                "value": float(verdict.value[0, 0]),
            },
        )

    def _follow(
        self, sightings: Sightings, time_au: torch.Tensor, num_targets: int
    ) -> torch.Tensor:
        """Take in what was measured since the last decision. -> tracks (1, N, T)."""
        for measurement in sightings.since(self._num_read):
            self._tracks.widen(len(measurement.seen))
            self._tracks.add(
                torch.tensor([measurement.time_au], dtype=torch.float64),
                torch.as_tensor(measurement.agent_au)[None],
                torch.as_tensor(measurement.seen)[None],
                torch.as_tensor(measurement.target_au)[None],
                torch.ones(1, dtype=torch.bool),
            )
        self._num_read = len(sightings)
        self._tracks.widen(num_targets)
        return self._tracks.features(time_au)

    def _believe(self, snapshot: Snapshot) -> tuple[torch.Tensor, torch.Tensor]:
        """The belief at every node. -> frame (1, V, N, 4), target mask (1, N); N >= 1."""
        nodes_au = torch.as_tensor(snapshot.roadmap.nodes_au)[None]
        query_au = frame_points(nodes_au, nodes_au.new_tensor([snapshot.time_au]))[0]
        mean, std = (torch.as_tensor(v) for v in snapshot.belief.posterior(query_au.numpy()))
        target_mask = torch.ones(1, max(1, len(mean)), dtype=torch.bool)
        if not len(mean):  # nothing is known of any target yet: one of which nothing is known
            mean, std = torch.zeros(1, len(query_au)), torch.ones(1, len(query_au))
            target_mask[:] = False
        return belief_features(mean, std)[None], target_mask


def _nearest_node(snapshot: Snapshot) -> int:
    """The roadmap node to decide at when the agent is at none, as after a pilot's excursion."""
    offset_au = snapshot.roadmap.nodes_au - snapshot.position_au
    return int(np.hypot(offset_au[:, 0], offset_au[:, 1]).argmin())
