"""The learned planner: an attention network chooses the next roadmap node, greedily.

The network is the paper's, with or without what is ours (`NetworkConfig`), as its checkpoint says.

Source: paper, section IV. Between decisions it keeps its encoded windows, so that each decision
encodes one.
"""

from __future__ import annotations

import numpy as np
import torch

from dronemon.arena import ARENA
from dronemon.belief import Belief
from dronemon.errors import PlannerError
from dronemon.planner.planner import Briefing, Snapshot, Waypoint
from dronemon.policy import (
    Checkpoint,
    Explanation,
    Graphs,
    History,
    Tracks,
    Verdict,
    belief_features,
    explain,
    find_checkpoint,
    frame_points,
    load_checkpoint,
)
from dronemon.problem import DEFAULT_HISTORY
from dronemon.roadmap import Roadmap, laplacian_encoding
from dronemon.sightings import Sightings

_Seen = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]
"""What `History.decide` takes."""


class LearnedPlanner:
    """Flies a trained policy network over the roadmap."""

    name = "stamp"

    def __init__(self, checkpoint: Checkpoint, *, history: int = DEFAULT_HISTORY) -> None:
        self._network = checkpoint.network
        self._history = history

    @classmethod
    def load(cls, checkpoint: str | None = None, history: int | None = None) -> LearnedPlanner:
        """The planner of a checkpoint's path or name; of the shipped one for None.

        history: T, how many decisions it looks back

        Raises CheckpointMismatch.
        """
        loaded = load_checkpoint(find_checkpoint(checkpoint))
        return cls(loaded, history=DEFAULT_HISTORY if history is None else history)

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        """Forget the last mission's history and encode the new roadmap.

        Raises PlannerError for a field other than that which its features and its training know.
        """
        if briefing.arena != ARENA:
            raise PlannerError(
                f"planner {self.name} was trained in the square of side 1 au and flies in no "
                "other field; search, tsp and lawnmower fly in any"
            )
        num_eigenvectors = self._network.config.num_eigenvectors
        self._nodes_au = roadmap.nodes_au
        self._graphs = Graphs.of(
            roadmap.nodes_au,
            laplacian_encoding(roadmap, num_eigenvectors),
            roadmap.neighbours,
            roadmap.distance_au,
        )
        self._memory = History(self._network, self._graphs, self._history)
        self._num_imagined = briefing.num_imagined
        self._tracks = Tracks(1, briefing.num_targets + self._num_imagined)
        self._num_read = 0
        priors_au = torch.as_tensor(briefing.priors_au.reshape(1, -1, 2))
        if not self._num_imagined:
            self._tracks.add_prior(priors_au.isfinite().all(-1), priors_au)
        if briefing.sightings is not None:
            self._read(briefing.sightings)

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """The neighbour with the greatest logit; details hold all logits and the value.

        And how many decisions were made since `reset`, this one counted.
        """
        node, seen = self._look(snapshot)
        verdict, self._explanations = explain(self._memory, *seen)
        return self._choose(node, verdict)

    def explanation(self) -> Explanation:
        """The weights of attention behind the newest waypoint."""
        (explanation,) = self._explanations()
        return explanation

    def _look(self, snapshot: Snapshot) -> tuple[int, _Seen]:
        """The agent's node, and what the network is shown there."""
        node = snapshot.node if snapshot.node is not None else _nearest_node(snapshot)
        frame = self._believe(snapshot)
        target_mask = torch.ones(1, frame.shape[2], dtype=torch.bool)
        time_au = torch.tensor([snapshot.time_au], dtype=torch.float64)
        self._read(snapshot.sightings)
        tracks = self._tracks.features(time_au)
        return node, (frame, target_mask, time_au, torch.tensor([node]), tracks)

    def _choose(self, node: int, verdict: Verdict) -> Waypoint:
        logits = verdict.logits[0, 0]
        allowed = self._graphs.neighbour_mask[0, node]
        neighbours = self._graphs.neighbours[0, node]
        chosen = int(neighbours[logits.argmax()])
        return Waypoint(
            position_au=self._nodes_au[chosen],
            node=chosen,
            details={
                "neighbours": neighbours[allowed].tolist(),
                "logits": logits[allowed].tolist(),
                "value": float(verdict.value[0, 0]),
                "num_decisions": self._memory.num_decisions,
            },
        )

    def _read(self, sightings: Sightings) -> None:
        """Take in what was measured since the last time, if the network is shown tracks."""
        ahead = self._num_imagined
        is_shown = self._network.config.tracks
        for measurement in sightings.since(self._num_read if is_shown else len(sightings)):
            self._tracks.widen(ahead + len(measurement.seen))
            self._tracks.add(
                torch.tensor([measurement.time_au], dtype=torch.float64),
                torch.as_tensor(measurement.agent_au)[None],
                torch.as_tensor(np.pad(measurement.seen, (ahead, 0)))[None],
                torch.as_tensor(np.pad(measurement.target_au, ((ahead, 0), (0, 0))))[None],
                torch.ones(1, dtype=torch.bool),
                measurement.view_au,
            )
        self._num_read = len(sightings)

    def _believe(self, snapshot: Snapshot) -> torch.Tensor:
        """The belief at every node. -> frame (1, V, N, 4).

        Differs from STAMP: where more targets may exist than are known, the first is imagined, so
        that the network sees where nobody has looked.
        """
        belief = snapshot.belief
        if self._num_imagined:
            belief = Belief(snapshot.sightings, belief.kernel, num_imagined=self._num_imagined)
        nodes_au = torch.as_tensor(snapshot.roadmap.nodes_au)[None]
        query_au = frame_points(nodes_au, nodes_au.new_tensor([snapshot.time_au]))[0]
        mean, std = (
            torch.as_tensor(np.roll(of_all, self._num_imagined, axis=0))
            for of_all in belief.posterior(query_au.numpy())
        )
        return belief_features(mean, std)[None]


def _nearest_node(snapshot: Snapshot) -> int:
    """The roadmap node to decide at when the agent is at none, as after a pilot's excursion."""
    offset_au = snapshot.roadmap.nodes_au - snapshot.position_au
    return int(np.hypot(offset_au[:, 0], offset_au[:, 1]).argmin())
