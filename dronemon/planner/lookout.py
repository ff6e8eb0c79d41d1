"""What a policy over the roadmap is shown of a mission: what `dronemon.env` shows of an episode.

But that an imagined target comes first, as the network has it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from dronemon.arena import ARENA
from dronemon.belief import Belief
from dronemon.errors import PlannerError
from dronemon.planner.planner import Briefing, Snapshot
from dronemon.policy import Tracks, belief_features, frame_points
from dronemon.sightings import Sightings


class Glance(NamedTuple):
    """What is shown at one decision, as a batch of one, in the order of `History.decide`.

    Targets are as in the log, behind one imagined where the prior leaves open how many there are.

    frame:       (1, V, N, 4) float32 mean and std at the nodes now, the same a little later
    target_mask: (1, N)       bool    true: all are known of, or imagined
    time_au:     (1,)         float64
    node:        (1,)         int64   where the agent stands, or the nearest to it
    tracks:      (1, N, T)    float32 what sightings say of each target, see `Tracks`
    """

    frame: Tensor
    target_mask: Tensor
    time_au: Tensor
    node: Tensor
    tracks: Tensor


class Lookout:
    """Follows one mission."""

    def __init__(self, briefing: Briefing, *, has_tracks: bool = True) -> None:
        """has_tracks: whether sightings are read for `Glance.tracks`.

        Raises PlannerError for a field other than that which features and training know.
        """
        if briefing.arena != ARENA:
            raise PlannerError(
                "a policy that learned in the square of side 1 au flies in no other field; search, "
                "tsp and lawnmower fly in any"
            )
        self.num_imagined = briefing.num_imagined
        self._has_tracks = has_tracks
        self._tracks = Tracks(1, briefing.num_targets + self.num_imagined)
        self._num_read = 0
        priors_au = torch.as_tensor(briefing.priors_au.reshape(1, -1, 2))
        if not self.num_imagined:
            self._tracks.add_prior(priors_au.isfinite().all(-1), priors_au)
        if briefing.sightings is not None:
            self._read(briefing.sightings)

    def look(self, snapshot: Snapshot) -> Glance:
        """What there is to see now."""
        node = snapshot.node if snapshot.node is not None else _nearest_node(snapshot)
        frame = self._believe(snapshot)
        time_au = torch.tensor([snapshot.time_au], dtype=torch.float64)
        self._read(snapshot.sightings)
        return Glance(
            frame=frame,
            target_mask=torch.ones(1, frame.shape[2], dtype=torch.bool),
            time_au=time_au,
            node=torch.tensor([node]),
            tracks=self._tracks.features(time_au),
        )

    def _read(self, sightings: Sightings) -> None:
        """Take in what was measured since the last time."""
        ahead = self.num_imagined
        first = self._num_read if self._has_tracks else len(sightings)
        believed_au = sightings.believed_au(first)
        for measurement, places_au in zip(sightings.since(first), believed_au, strict=True):
            known = len(measurement.seen)
            seen = measurement.seen & ~np.isnan(places_au[:known, 0])
            self._tracks.widen(ahead + known)
            self._tracks.add(
                torch.tensor([measurement.time_au], dtype=torch.float64),
                torch.as_tensor(measurement.agent_au)[None],
                torch.as_tensor(np.pad(seen, (ahead, 0)))[None],
                torch.as_tensor(np.pad(measurement.target_au, ((ahead, 0), (0, 0))))[None],
                torch.ones(1, dtype=torch.bool),
                measurement.view_au,
            )
        self._num_read = len(sightings)

    def _believe(self, snapshot: Snapshot) -> Tensor:
        """The belief at every node. -> frame (1, V, N, 4).

        Differs from STAMP: where more targets may exist than are known, the first is imagined, so
        that the network sees where nobody has looked.
        """
        belief = snapshot.belief
        if self.num_imagined:
            belief = Belief(snapshot.sightings, belief.kernel, num_imagined=self.num_imagined)
        nodes_au = torch.as_tensor(snapshot.roadmap.nodes_au)[None]
        query_au = frame_points(nodes_au, nodes_au.new_tensor([snapshot.time_au]))[0]
        mean, std = (
            torch.as_tensor(np.roll(of_all, self.num_imagined, axis=0))
            for of_all in belief.posterior(query_au.numpy())
        )
        return belief_features(mean, std)[None]


def _nearest_node(snapshot: Snapshot) -> int:
    """The roadmap node to decide at when the agent is at none, as after a pilot's excursion."""
    offset_au = snapshot.roadmap.nodes_au - snapshot.position_au
    return int(np.hypot(offset_au[:, 0], offset_au[:, 1]).argmin())
