"""Many episodes at once: world, belief and roadmap in step, for learning and fast experiments.

    reset(setups)      -> Observation   draw the instances; everyone stands at node 0
    step(nodes)        -> Step          fly to a neighbouring node, measuring every 0.1 au flown
    step_to(places_au) -> Step          fly to any place, likewise

Source: paper, sections III and IV-A.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dronemon.arena import ARENA
from dronemon.belief import ObservationStore, fit
from dronemon.belief.grid import evaluation_grid
from dronemon.belief.metrics import area_std
from dronemon.policy import Graphs, Tracks, belief_features, frame_points
from dronemon.problem import MEASUREMENT_INTERVAL_AU, SENSOR_RADIUS_AU, Prior
from dronemon.roadmap import Roadmap, laplacian_encoding
from dronemon.types import FloatArray
from dronemon.world import Instance, num_due, share_at


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """One episode's terms.

    num_nodes: the start not counted; speed_ratio: the targets' speed over the agent's;
    prior:     what is known of the targets at the start
    """

    seed: int
    num_targets: int
    num_nodes: int = 200
    speed_ratio: float = 0.1
    prior: Prior = "full"


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What the agents know when they stand at a node; padded to the largest V, N and K.

    frames:         (B, V, N, 4) float32 mean and std at the nodes now, the same a little later
    target_mask:    (B, N)       bool    targets that are known of, and one imagined, the last,
                                         where the prior leaves open how many there are
    position_au:    (B, 2)               where the agent is
    node:           (B,)         int64   where it stands, or the nearest to it
    neighbours:     (B, K)       int64   nodes it may go to,
    neighbour_mask: (B, K)       bool    where true
    length_au:      (B,)                 flown so far, which is the time
    tracks:         (B, N, T)    float32 what sightings say of each target, see `Tracks`
    """

    frames: Tensor
    target_mask: Tensor
    position_au: Tensor
    node: Tensor
    neighbours: Tensor
    neighbour_mask: Tensor
    length_au: Tensor
    tracks: Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """What a step led to.

    observation: after it
    reward:      (B,)   fall of sigma_bar over the leg, summed over the targets where it fell
    area_std:    (B, N) sigma_bar at the leg's end: 1 for targets unknown, NaN where there is none,
                 as of one imagined
    """

    observation: Observation
    reward: Tensor
    area_std: Tensor


class Env:
    """B episodes that decide in step, for as long as they are played.

    One seed is one instance, in any batch. `num_threads` share the beliefs' work, as `fit` has it.
    """

    def __init__(
        self,
        *,
        num_neighbours: int = 10,
        device: torch.device | str = "cpu",
        num_threads: int = 1,
    ) -> None:
        self._num_neighbours = num_neighbours
        self._device = torch.device(device)
        self._num_threads = num_threads

    def reset(self, setups: Sequence[Setup]) -> Observation:
        """Begin one episode per setup."""
        is_open = torch.tensor([setup.prior == "none" for setup in setups], device=self._device)
        num_targets = max(setup.num_targets for setup in setups) + int(is_open.any())
        batch = len(setups)
        instances = [Instance.draw(setup.seed, setup.num_targets) for setup in setups]
        graphs, nodes_au = [], []
        for setup, i in zip(setups, instances, strict=True):
            k = self._num_neighbours
            r = Roadmap.random(setup.num_nodes, k, i.stream("roadmap"), i.start_au)
            graphs.append(Graphs.of(r.nodes_au, laplacian_encoding(r), r.neighbours, r.distance_au))
            nodes_au.append(r.nodes_au)
        self.graphs = Graphs.concatenate(graphs).to(self._device)
        self._nodes_au = self._stacked(nodes_au, max(map(len, nodes_au)))
        paths = [instance.paths for instance in instances]
        self._waypoints_au = self._stacked([p.points_au for p in paths], num_targets)
        self._marks_au = self._stacked([p.marks_au for p in paths], num_targets)
        self._speed_ratio = self._nodes_au.new_tensor([setup.speed_ratio for setup in setups])
        counts = torch.tensor([setup.num_targets for setup in setups], device=self._device)
        self._exists = torch.arange(num_targets, device=self._device) < counts[:, None]
        is_placed, is_counted = (
            torch.tensor([s.prior in priors for s in setups], device=self._device)[:, None]
            for priors in (("full",), ("full", "number"))
        )
        is_imagined = torch.arange(num_targets, device=self._device) == num_targets - 1
        self._known = (self._exists & is_counted) | (is_imagined & is_open[:, None])
        self._rows = torch.arange(batch, device=self._device)
        self._node, self._num_measured = (torch.zeros_like(self._rows) for _ in range(2))
        self._position_au = self._nodes_au[:, 0]
        self._length_au = torch.zeros_like(self._speed_ratio)
        targets_au = self.targets_au
        self._store = ObservationStore(batch, num_targets, device=self._device)
        self._store.add_prior(self._exists & is_placed, targets_au)
        self._tracks = Tracks(batch, num_targets, device=self._device)
        self._tracks.add_prior(self._exists & is_placed, targets_au)
        self._believe()
        return self._observe()

    def step(self, nodes: Tensor) -> Step:
        """Fly to a neighbouring node. nodes: (B,) int64 -> what came of it.

        Raises ValueError if a node is not a neighbour of the one where the agent stands.
        """
        allowed, mask = self._neighbours()
        is_neighbour = ((allowed == nodes[:, None]) & mask).any(dim=1)
        if not bool(is_neighbour.all()):
            episode = int(is_neighbour.int().argmin())
            raise ValueError(
                f"episode {episode}: node {int(nodes[episode])} is no neighbour of node"
                f" {int(self._node[episode])}; choose where neighbour_mask is true"
            )
        return self._step(self._nodes_au[self._rows, nodes], nodes.clone())

    def step_to(self, places_au: Tensor) -> Step:
        """Fly straight to any place. places_au: (B, 2) -> what came of it.

        No time passes where the agent is there already. Raises ValueError if a place is outside.
        """
        places_au = torch.clone(places_au).to(self._nodes_au)
        if not (is_inside := ARENA.contains(places_au.cpu().numpy())).all():
            episode = int(is_inside.argmin())
            raise ValueError(
                f"episode {episode}: {places_au[episode].tolist()} is outside the arena, which"
                f" reaches from {ARENA.low_au} to {ARENA.high_au} au"
            )
        offset_au = self._nodes_au - places_au[:, None]
        return self._step(places_au, torch.linalg.vector_norm(offset_au, dim=-1).argmin(dim=1))

    def _step(self, goal_au: Tensor, nodes: Tensor) -> Step:
        """Fly there, and be at these nodes then. goal_au: (B, 2); nodes: (B,)."""
        self._fly(goal_au)
        self._node = nodes
        before = self._area_std
        self._believe()
        return Step(
            observation=self._observe(),
            reward=(before - self._area_std).clamp_min(0.0).nansum(dim=1),
            area_std=self._area_std,
        )

    def observations(self) -> tuple[Tensor, Tensor, Tensor]:
        """What the beliefs are conditioned on, as `fit` takes it: points, values, mask."""
        points, values, counts = self._store.window()
        return points, values, counts & self._known[..., None]

    @property
    def targets_au(self) -> Tensor:
        """Where the targets truly are now. -> (B, N, 2) au, anything where there is none."""
        return self._targets_at(self._length_au)

    def query(self) -> Tensor:
        """Where beliefs are looked at, the same for all targets. -> (B, 1, 2V, 3) au."""
        return frame_points(self._nodes_au, self._length_au)[:, None]

    def _neighbours(self) -> tuple[Tensor, Tensor]:
        """Where agents may go. -> (B, K) nodes, (B, K) bool where there is one."""
        at = self._rows, self._node
        return self.graphs.neighbours[at], self.graphs.neighbour_mask[at]

    def _fly(self, goal_au: Tensor) -> None:
        """Fly one leg and measure on it. goal_au: (B, 2) where to."""
        start_au = self._position_au
        offset_au = goal_au - start_au
        leg_au = torch.linalg.vector_norm(offset_au, dim=-1)
        residual_au = self._length_au - MEASUREMENT_INTERVAL_AU * self._num_measured.double()
        count = num_due(residual_au, leg_au).long()
        for number in range(1, int(count.max()) + 1):
            share = share_at(torch.full_like(leg_au, number), residual_au, leg_au)[:, None]
            time_au = (self._num_measured + number).double() * MEASUREMENT_INTERVAL_AU
            self._measure(time_au, start_au + share * offset_au, number <= count)
        self._position_au = goal_au
        self._length_au = self._length_au + leg_au
        self._num_measured = self._num_measured + count

    def _measure(self, time_au: Tensor, agent_au: Tensor, active: Tensor) -> None:
        """Read the sensor in some episodes. time_au: (B,); agent_au: (B, 2); active: (B,) bool."""
        targets_au = self._targets_at(time_au)
        distance_au = torch.linalg.vector_norm(targets_au - agent_au[:, None], dim=-1)
        seen = (distance_au < SENSOR_RADIUS_AU) & self._exists
        self._tracks.add(time_au, agent_au, seen, targets_au, active)
        self._store.add(time_au, agent_au, seen, targets_au, active)
        self._known = self._known | (seen & active[:, None])

    def _targets_at(self, time_au: Tensor) -> Tensor:
        """Where targets are, as `TargetPaths.positions_au` has it. time_au: (B,) -> (B, N, 2)."""
        length_au = self._marks_au[..., -1]  # (B, N)
        phase = torch.remainder((self._speed_ratio * time_au)[:, None], 2.0 * length_au)
        arc = torch.where(phase > length_au, 2.0 * length_au - phase, phase)[..., None]
        segment = torch.searchsorted(self._marks_au, arc, right=True) - 1
        segment = segment.clamp(0, self._marks_au.shape[-1] - 2)  # (B, N, 1)
        begin, end = (self._marks_au.gather(-1, segment + k) for k in (0, 1))
        share = (arc - begin) / (end - begin)
        corner = segment[..., None].expand(-1, -1, -1, 2)
        first, second = (self._waypoints_au.gather(2, corner + k)[:, :, 0] for k in (0, 1))
        return first + share * (second - first)

    def _believe(self) -> None:
        """Condition the belief on what was measured, and judge it around the targets."""
        self._posterior = fit(*self.observations(), num_threads=self._num_threads)
        targets_au = self.targets_au
        time_au = self._length_au[:, None].expand(targets_au.shape[:-1])
        std = area_std(self._posterior, targets_au, time_au, evaluation_grid(ARENA))
        self._area_std = torch.where(self._exists, std, torch.nan)

    def _observe(self) -> Observation:
        """Predict the belief at every node, now and a little later."""
        neighbours, neighbour_mask = self._neighbours()
        return Observation(
            frames=belief_features(*self._posterior.predict(self.query())),
            target_mask=self._known,
            position_au=self._position_au,
            node=self._node,
            neighbours=neighbours,
            neighbour_mask=neighbour_mask,
            length_au=self._length_au,
            tracks=self._tracks.features(self._length_au),
        )

    def _stacked(self, arrays: Sequence[FloatArray], size: int) -> Tensor:
        """Arrays of different first dimensions in one, the last rows repeated as padding."""
        padded = [a[np.arange(size).clip(max=len(a) - 1)] for a in arrays]
        return torch.as_tensor(np.stack(padded), device=self._device)
