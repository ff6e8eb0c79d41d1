"""A mission observed as an episode is, so that a policy trained on these can be a planner."""

from __future__ import annotations

import numpy as np

from dronemon.gym.scene import Scene, Shown, line
from dronemon.planner import Briefing, Snapshot, Waypoint
from dronemon.planner.lookout import Lookout
from dronemon.roadmap import MAX_ADDED_NEIGHBOURS, Roadmap


class Observer:
    """Observes one mission after another as `Monitoring` would; `reset` begins each.

    V and K are those of the mission's roadmap, N the targets known of. Where the prior leaves open
    how many there are, N grows with them, in the order in which they are found, and the one
    imagined comes last.
    """

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        """Begin a mission. Raises PlannerError for a field other than the square."""
        self._lookout = Lookout(briefing)
        self._nodes_au = roadmap.nodes_au
        # A roadmap that falls apart is joined at some nodes; the others have just their nearest.
        num_nearest = int(roadmap.is_move.sum(axis=1).min())
        self._scene = Scene(
            roadmap.nodes_au.astype(np.float32)[None],
            roadmap.neighbours[None],
            roadmap.is_move[None],
            num_nearest + MAX_ADDED_NEIGHBOURS,
        )

    def observe(self, snapshot: Snapshot) -> Shown:
        """What is observed now, by name; shapes and units: docs/laboratory.md."""
        glance = self._lookout.look(snapshot)
        self._node = glance.node.numpy()
        ahead = self._lookout.num_imagined
        shown = self._scene.show(
            node=self._node,
            position_au=snapshot.position_au[None],
            time_au=glance.time_au.numpy(),
            belief=np.roll(glance.frame.numpy(), -ahead, axis=2),
            target_mask=glance.target_mask.numpy(),
            tracks=np.roll(glance.tracks.numpy(), -ahead, axis=1),
        )
        return line(shown, 0)

    def waypoint(self, action: int) -> Waypoint:
        """Where an action leads, a `neighbour` chosen at what was observed last."""
        (node,) = self._scene.follow(self._node, np.array([action])).tolist()
        return Waypoint(position_au=self._nodes_au[node], node=node)
