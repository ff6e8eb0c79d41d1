"""Many episodes at once: world, belief and roadmap in step, for learning and fast experiments.

    reset(setups)  -> Observation   draw the instances; everyone stands at node 0
    step(nodes)    -> Step          fly to a neighbouring node, measuring every 0.1 au on the way

Source: paper, sections III and IV-A.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dronemon.belief import Matern32, ObservationStore, Posterior, fit
from dronemon.belief.metrics import area_std
from dronemon.policy import Graphs, Tracks, belief_features
from dronemon.problem import (
    MEASUREMENT_INTERVAL_AU,
    SENSOR_RADIUS_AU,
    Prior,
)
from dronemon.roadmap import Roadmap, laplacian_encoding
from dronemon.world import Instance, num_due, share_at


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """One episode's terms.

    num_nodes: the start not counted; speed_ratio: the targets' speed over the agent's.
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
    target_mask:    (B, N)       bool    targets believed in
    node:           (B,)         int64   where the agent stands
    neighbours:     (B, K)       int64   nodes it may go to,
    neighbour_mask: (B, K)       bool    where true
    length_au:      (B,)                 flown so far, which is the time
    tracks:         (B, N, T)    float32 what sightings say of each target, see `Tracks`
    """

    frames: Tensor
    target_mask: Tensor
    node: Tensor
    neighbours: Tensor
    neighbour_mask: Tensor
    length_au: Tensor
    tracks: Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """What a step led to.

    observation: after it; of the next episode where one terminated
    reward:      (B,)      fall of sigma_bar over the leg, summed over the targets where it fell
    area_std:    (B, N)    sigma_bar at the leg's end; NaN for targets that do not exist
    terminated:  (B,) bool the length is flown
    truncated:   (B,) bool the number of decisions is taken; `reset` comes next
    """

    observation: Observation
    reward: Tensor
    area_std: Tensor
    terminated: Tensor
    truncated: Tensor


class Env:
    """B episodes that decide in step.

    An episode that has flown its length starts anew, with the next instance of its seed, until
    all have taken `max_decisions`. One seed is one sequence of instances, in any batch.
    `num_threads` share the beliefs' work, as `fit` has it.
    """

    def __init__(
        self,
        *,
        horizon_au: float = math.inf,
        max_decisions: int = 256,
        num_neighbours: int = 10,
        prediction_au: float = 2.0,
        kernel: Matern32 | None = None,
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
        num_threads: int = 1,
    ) -> None:
        self._horizon_au = horizon_au
        self._max_decisions = max_decisions
        self._num_neighbours = num_neighbours
        self._prediction_au = prediction_au
        self._kernel = kernel if kernel is not None else Matern32()
        self._dtype = dtype
        self._device = torch.device(device)
        self._num_threads = num_threads

    @property
    def graphs(self) -> Graphs:
        """Roadmaps of the episodes under way; others after an episode terminated."""
        return self._graphs

    def reset(self, setups: Sequence[Setup]) -> Observation:
        """Begin one episode per setup."""
        batch, num_targets = len(setups), max(setup.num_targets for setup in setups)
        self._setups = tuple(setups)
        self._num_restarts = [0] * batch
        self._num_decisions = 0
        self._drawn: list[_Drawn] = [_Drawn.of(s, 0, self._num_neighbours) for s in setups]
        self._rows = torch.arange(batch, device=self._device)
        self._store = ObservationStore(
            batch,
            num_targets,
            window_au=self._kernel.window_au,
            dtype=self._dtype,
            device=self._device,
        )
        self._tracks = Tracks(batch, num_targets, device=self._device)
        # Lengths and places are kept in float64 whatever the belief's precision.
        self._length_au = torch.zeros(batch, dtype=torch.float64, device=self._device)
        self._position_au = torch.zeros(batch, 2, dtype=torch.float64, device=self._device)
        self._num_measured = torch.zeros(batch, dtype=torch.int64, device=self._device)
        self._node = torch.zeros(batch, dtype=torch.int64, device=self._device)
        self._is_known = torch.zeros(batch, num_targets, dtype=torch.bool, device=self._device)
        self._begin(range(batch))
        self._believe()
        return self._observe()

    def step(self, nodes: Tensor) -> Step:
        """Fly to a neighbouring node. nodes: (B,) int64 -> what came of it.

        Raises ValueError if a node is not a neighbour of the one where the agent stands.
        """
        graphs, rows = self._graphs, self._rows
        is_neighbour = (graphs.neighbours[rows, self._node] == nodes[:, None]) & (
            graphs.neighbour_mask[rows, self._node]
        )
        if not bool(is_neighbour.any(dim=1).all()):
            episode = int(is_neighbour.any(dim=1).int().argmin())
            raise ValueError(
                f"episode {episode}: node {int(nodes[episode])} is no neighbour of node"
                f" {int(self._node[episode])}; choose where neighbour_mask is true"
            )
        self._fly(self._nodes_au[rows, nodes])
        self._node = nodes.clone()
        before = self._area_std
        self._believe()
        area_std, terminated = self._area_std, self._length_au > self._horizon_au - 1e-9
        self._num_decisions += 1
        is_over = self._num_decisions >= self._max_decisions
        if not is_over and bool(terminated.any()):
            self._restart(terminated.nonzero()[:, 0].tolist())
        return Step(
            observation=self._observe(),
            reward=(before - area_std).clamp_min(0.0).nansum(dim=1),
            area_std=area_std,
            terminated=terminated,
            truncated=torch.full_like(terminated, is_over),
        )

    def observations(self) -> tuple[Tensor, Tensor, Tensor]:
        """What the beliefs are conditioned on, as `fit` takes it: points, values, mask."""
        points, values, counts = self._store.window()
        return points, values, counts & self._is_known[..., None]

    def query(self) -> Tensor:
        """Where beliefs are looked at: the nodes now, then a little later. -> (B, 1, 2V, 3) au."""
        nodes_au = self._nodes_au.to(self._dtype)
        times_au = torch.stack([self._length_au, self._length_au + self._prediction_au], dim=1)
        times_au = times_au.to(self._dtype).repeat_interleave(nodes_au.shape[1], dim=1)
        return torch.cat([nodes_au.repeat(1, 2, 1), times_au[..., None]], dim=-1)[:, None]

    def _begin(self, episodes: Sequence[int]) -> None:
        """Put some episodes at the start of what was drawn for them."""
        self._graphs = Graphs.concatenate([d.graphs for d in self._drawn]).to(self._device)
        self._nodes_au = self._stacked([d.nodes_au for d in self._drawn])
        self._waypoints_au = self._stacked([d.waypoints_au for d in self._drawn])
        steps_au = torch.linalg.vector_norm(self._waypoints_au.diff(dim=2), dim=-1)
        self._marks_au = torch.nn.functional.pad(steps_au.cumsum(dim=-1), (1, 0))
        speeds = [setup.speed_ratio for setup in self._setups]
        self._speed_ratio = torch.tensor(speeds, dtype=torch.float64, device=self._device)
        counts = torch.tensor([s.num_targets for s in self._setups], device=self._device)
        self._exists = torch.arange(self._store.num_targets, device=self._device) < counts[:, None]

        starts = torch.tensor(list(episodes), device=self._device)
        self._length_au[starts] = 0.0
        self._num_measured[starts] = 0
        self._node[starts] = 0
        self._position_au[starts] = self._nodes_au[starts, 0]
        priors = np.array([setup.prior for setup in self._setups])
        is_counted = torch.as_tensor(priors != "none", device=self._device)
        is_placed = torch.as_tensor(priors == "full", device=self._device)
        self._is_known[starts] = (self._exists & is_counted[:, None])[starts]
        is_start = torch.zeros_like(is_placed)
        is_start[starts] = True
        self._store.clear(is_start)
        self._tracks.clear(is_start)
        known = self._exists & (is_placed & is_start)[:, None]
        targets_au = self._targets_at(self._length_au)
        self._tracks.add_prior(known, targets_au)
        self._store.add_prior(known, targets_au.to(self._dtype))

    def _restart(self, episodes: Sequence[int]) -> None:
        """Begin the next instance of some episodes' seeds."""
        for episode in episodes:
            self._num_restarts[episode] += 1
            self._drawn[episode] = _Drawn.of(
                self._setups[episode], self._num_restarts[episode], self._num_neighbours
            )
        self._begin(episodes)
        self._believe()

    def _fly(self, goal_au: Tensor) -> None:
        """Fly one leg, no further than the horizon, and measure on it. goal_au: (B, 2)."""
        offset_au = goal_au - self._position_au
        leg_au = torch.linalg.vector_norm(offset_au, dim=-1)
        flown_au = torch.minimum(leg_au, self._horizon_au - self._length_au)
        residual_au = self._length_au - MEASUREMENT_INTERVAL_AU * self._num_measured.double()
        count = num_due(residual_au, flown_au).long()
        for number in range(1, int(count.max()) + 1):
            share = share_at(torch.full_like(leg_au, number), residual_au, leg_au)[:, None]
            time_au = (self._num_measured + number).double() * MEASUREMENT_INTERVAL_AU
            self._measure(time_au, self._position_au + share * offset_au, number <= count)
        share = (flown_au / leg_au)[:, None]
        self._position_au = torch.where(share < 1.0, self._position_au + share * offset_au, goal_au)
        self._length_au = self._length_au + flown_au
        self._num_measured = self._num_measured + count

    def _measure(self, time_au: Tensor, agent_au: Tensor, active: Tensor) -> None:
        """Read the sensor in some episodes. time_au: (B,); agent_au: (B, 2); active: (B,) bool."""
        targets_au = self._targets_at(time_au)
        distance_au = torch.linalg.vector_norm(targets_au - agent_au[:, None], dim=-1)
        seen = (distance_au < SENSOR_RADIUS_AU) & self._exists
        self._is_known |= seen & active[:, None]
        self._tracks.add(time_au, agent_au, seen, targets_au, active)
        self._store.add(
            time_au.to(self._dtype),
            agent_au.to(self._dtype),
            seen,
            targets_au.to(self._dtype),
            active,
        )

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
        self._posterior: Posterior = fit(
            *self.observations(), kernel=self._kernel, num_threads=self._num_threads
        )
        targets_au = self._targets_at(self._length_au).to(self._dtype)
        time_au = self._length_au.to(self._dtype)[:, None].expand(targets_au.shape[:-1])
        std = area_std(self._posterior, targets_au, time_au)
        self._area_std = torch.where(self._exists, std, torch.nan)

    def _observe(self) -> Observation:
        """Predict the belief at every node, now and a little later."""
        mean, std = self._posterior.predict(self.query())  # (B, N, 2V)
        (mean_now, mean_later), (std_now, std_later) = mean.chunk(2, -1), std.chunk(2, -1)
        return Observation(
            frames=belief_features(mean_now, std_now, mean_later, std_later),
            target_mask=self._is_known.clone(),
            node=self._node,
            neighbours=self._graphs.neighbours[self._rows, self._node],
            neighbour_mask=self._graphs.neighbour_mask[self._rows, self._node],
            length_au=self._length_au.clone(),
            tracks=self._tracks.features(self._length_au),
        )

    def _stacked(self, arrays: Sequence[Tensor]) -> Tensor:
        """Put tensors of different first dimensions into one, the last rows repeated as padding."""
        longest = max(len(a) for a in arrays)
        padded = [torch.cat([a, a[-1:].expand(longest - len(a), *a.shape[1:])]) for a in arrays]
        return torch.stack(padded).to(self._device)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Drawn:
    """One instance as tensors: waypoints_au: (N, P, 2) of the targets' paths; nodes_au: (V, 2)."""

    waypoints_au: Tensor
    nodes_au: Tensor
    graphs: Graphs

    @classmethod
    def of(cls, setup: Setup, restart: int, num_neighbours: int) -> _Drawn:
        """Draw the instance of a seed, or one of those that follow when episodes restart."""
        seed = setup.seed
        if restart:
            spawned = np.random.SeedSequence(setup.seed, spawn_key=(restart,))
            seed = int(spawned.generate_state(1, np.uint64)[0])
        instance = Instance.draw(seed, setup.num_targets)
        roadmap = Roadmap.random(
            setup.num_nodes, num_neighbours, instance.stream("roadmap"), instance.start_au
        )
        nodes_au = torch.as_tensor(roadmap.nodes_au)
        return cls(
            waypoints_au=torch.as_tensor(instance.paths.points_au),
            nodes_au=nodes_au,
            graphs=Graphs.of(
                nodes_au,
                torch.as_tensor(laplacian_encoding(roadmap)),
                torch.as_tensor(roadmap.neighbours),
                torch.as_tensor(roadmap.distance_au),
            ),
        )
