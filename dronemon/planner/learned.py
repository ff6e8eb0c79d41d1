"""The learned planner: an attention network chooses the next roadmap node, greedily.

The network is the paper's, with or without what is ours (`NetworkConfig`), as its checkpoint says.

Source: paper, section IV. Between decisions it keeps its encoded windows, so that each decision
encodes one.
"""

from __future__ import annotations

from dronemon.planner.lookout import Lookout
from dronemon.planner.planner import Briefing, Snapshot, Waypoint
from dronemon.policy import (
    Checkpoint,
    Explanation,
    Graphs,
    History,
    Verdict,
    explain,
    find_checkpoint,
    load_checkpoint,
)
from dronemon.problem import DEFAULT_HISTORY
from dronemon.roadmap import Roadmap, laplacian_encoding


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

        Raises PlannerError for a field other than the square.
        """
        self._lookout = Lookout(briefing, has_tracks=self._network.config.tracks)
        num_eigenvectors = self._network.config.num_eigenvectors
        self._nodes_au = roadmap.nodes_au
        self._graphs = Graphs.of(
            roadmap.nodes_au,
            laplacian_encoding(roadmap, num_eigenvectors),
            roadmap.neighbours,
            roadmap.distance_au,
        )
        self._memory = History(self._network, self._graphs, self._history)

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        """The neighbour with the greatest logit; details hold all logits and the value.

        And how many decisions were made since `reset`, this one counted.
        """
        glance = self._lookout.look(snapshot)
        verdict, self._explanations = explain(self._memory, *glance)
        return self._choose(int(glance.node), verdict)

    def explanation(self) -> Explanation:
        """The weights of attention behind the newest waypoint."""
        (explanation,) = self._explanations()
        return explanation

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
