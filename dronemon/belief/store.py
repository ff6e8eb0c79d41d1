"""Observations and their forgetting: what each Gaussian process is conditioned on.

`ObservationStore` holds many episodes at once, for learning; `Belief` is the single vehicle's view
of one, for flight and planners.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from dronemon.belief.gp import Posterior, fit
from dronemon.belief.kernel import Matern32
from dronemon.errors import BeliefError
from dronemon.problem import WINDOW_TIME_SCALES
from dronemon.types import FloatArray, Measurement

DEFAULT_CAPACITY = 60
"""Measurements in a window of 1.993 · 3 au at one per 0.1 au."""


class ObservationStore:
    """The latest observations of B episodes with N targets each, in tensors that are reused.

    A measurement gives every target one observation: its own position and value 1 where it was
    seen, the agent's position and value 0 where it was not. Each target may have one prior
    observation besides. A new measurement takes the place of the oldest; the store grows if that
    one still counts, so irregular measuring loses nothing.
    Source: paper, equation 1 and section III-C.
    """

    def __init__(
        self,
        batch: int,
        num_targets: int,
        *,
        window_au: float,
        capacity: int = DEFAULT_CAPACITY,
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
    ) -> None:
        shape = (batch, num_targets, 1 + capacity)  # slot 0 holds the prior, the others the ring
        self.window_au = window_au
        self._points = torch.zeros((*shape, 3), dtype=dtype, device=device)
        self._values = torch.zeros(shape, dtype=dtype, device=device)
        self._is_filled = torch.zeros(shape, dtype=torch.bool, device=device)
        self._measured_au = torch.full((batch, capacity), -torch.inf, dtype=dtype, device=device)
        self._agent_au = torch.zeros((batch, capacity, 2), dtype=dtype, device=device)
        self._rows = torch.arange(batch, device=device)

    @property
    def capacity(self) -> int:
        """Measurements that fit in before the oldest is replaced or the store grows."""
        return self._measured_au.shape[1]

    @property
    def num_targets(self) -> int:
        """Targets per episode."""
        return self._points.shape[1]

    def clear(self, episodes: Tensor) -> None:
        """Forget everything about some episodes. episodes: (B,) bool or indices."""
        self._is_filled[episodes] = False
        self._measured_au[episodes] = -torch.inf

    def add_prior(self, known: Tensor, target_au: Tensor, time_au: float = 0.0) -> None:
        """Set the prior observation of some targets. known: (B, N) bool; target_au: (B, N, 2)."""
        prior = torch.cat([target_au, torch.full_like(target_au[..., :1], time_au)], dim=-1)
        self._points[:, :, 0] = torch.where(known[..., None], prior, self._points[:, :, 0])
        self._values[:, :, 0] = torch.where(known, 1.0, self._values[:, :, 0])
        self._is_filled[:, :, 0] |= known

    def add(
        self,
        time_au: Tensor,
        agent_au: Tensor,
        seen: Tensor,
        target_au: Tensor,
        active: Tensor | None = None,
    ) -> None:
        """Add one measurement to each episode.

        time_au:   (B,)      au, not before the episode's last
        agent_au:  (B, 2)    au
        seen:      (B, N)    bool
        target_au: (B, N, 2) au, read where seen
        active:    (B,)      bool; false leaves that episode as it is; all by default
        """
        active = active if active is not None else torch.ones_like(time_au, dtype=torch.bool)
        oldest_au, slot = self._measured_au.min(dim=1)
        if bool((active & (time_au - oldest_au < self.window_au)).any()):
            self._grow()
            slot = self._measured_au.argmin(dim=1)
        keep = active[:, None]
        ring = (self._rows, slot)
        self._measured_au[ring] = torch.where(active, time_au, self._measured_au[ring])
        self._agent_au[ring] = torch.where(keep, agent_au, self._agent_au[ring])
        place = torch.where(seen[..., None], target_au, agent_au[:, None])  # (B, N, 2)
        point = torch.cat([place, time_au[:, None, None].expand_as(place[..., :1])], dim=-1)
        at = (self._rows, slice(None), 1 + slot)
        self._points[at] = torch.where(keep[..., None], point, self._points[at])
        self._values[at] = torch.where(keep, seen.to(point.dtype), self._values[at])
        self._is_filled[at] |= keep

    def add_target(self) -> None:
        """Let one more target join every episode; past measurements count as not having seen it."""
        point = torch.cat([self._agent_au, self._measured_au[..., None]], dim=-1)[:, None]
        is_filled = torch.isfinite(self._measured_au)[:, None]
        pad = torch.nn.functional.pad  # in front, the new target's empty prior
        self._points = torch.cat([self._points, pad(point, (0, 0, 1, 0))], dim=1)
        self._values = torch.cat(
            [self._values, pad(torch.zeros_like(point[..., 0]), (1, 0))], dim=1
        )
        self._is_filled = torch.cat([self._is_filled, pad(is_filled, (1, 0))], dim=1)

    def window(self) -> tuple[Tensor, Tensor, Tensor]:
        """Observations that still count at the time of each episode's last measurement.

        -> points (B, N, n, 3) au, values (B, N, n), mask (B, N, n) bool: true where one counts.
        The tensors are the store's own: read them before the next `add`.
        """
        latest_au = self._measured_au.amax(dim=1).clamp_min(0.0)  # (B,)
        age_au = latest_au[:, None, None] - self._points[..., 2]
        return self._points, self._values, self._is_filled & (age_au < self.window_au)

    def _grow(self) -> None:
        """Double the number of measurements that fit in."""
        pad, extra = torch.nn.functional.pad, self.capacity
        self._measured_au = pad(self._measured_au, (0, extra), value=-torch.inf)
        self._agent_au = pad(self._agent_au, (0, 0, 0, extra))
        self._points = pad(self._points, (0, 0, 0, extra))
        self._values = pad(self._values, (0, extra))
        self._is_filled = pad(self._is_filled, (0, extra))


class Belief:
    """What one vehicle believes about all its targets, from the measurements it was given.

    The belief changes only when something is added; the fit is kept until then.
    """

    def __init__(self, num_targets: int, kernel: Matern32 | None = None) -> None:
        self.kernel = kernel if kernel is not None else Matern32()
        window_au = WINDOW_TIME_SCALES * self.kernel.length_scales_au[2]
        self._store = ObservationStore(1, num_targets, window_au=window_au)
        self._time_au = 0.0
        self._posterior: Posterior | None = None

    @property
    def num_targets(self) -> int:
        """Targets believed in."""
        return self._store.num_targets

    def add(self, measurement: Measurement) -> None:
        """Take in what the sensor said about every target.

        Raises BeliefError if it is older than the last one, not finite, or about another number
        of targets.
        """
        seen, target_au = measurement.seen, measurement.target_au
        if seen.shape != (self.num_targets,) or target_au.shape != (self.num_targets, 2):
            raise BeliefError(
                f"measurement of {seen.shape[0]} targets given to a belief of {self.num_targets};"
                " call add_target() for each one that joins"
            )
        if not measurement.time_au >= self._time_au:
            raise BeliefError(
                f"measurement at {measurement.time_au:g} au given after {self._time_au:g} au;"
                " add measurements in the order of their time"
            )
        if not (np.isfinite(measurement.agent_au).all() and np.isfinite(target_au[seen]).all()):
            raise BeliefError(
                f"measurement at {measurement.time_au:g} au has positions that are not finite:"
                f" agent {measurement.agent_au}, targets seen {target_au[seen].tolist()}"
            )
        self._store.add(
            torch.tensor([measurement.time_au], dtype=torch.float64),
            torch.as_tensor(measurement.agent_au, dtype=torch.float64)[None],
            torch.as_tensor(seen)[None],
            torch.as_tensor(target_au, dtype=torch.float64)[None],
        )
        self._time_au = measurement.time_au
        self._posterior = None

    def add_prior(self, index: int, position_au: FloatArray, time_au: float = 0.0) -> None:
        """Tell where a target was before the first measurement. position_au: (2,) au."""
        known = torch.zeros((1, self.num_targets), dtype=torch.bool)
        known[0, index] = True
        target_au = torch.as_tensor(position_au, dtype=torch.float64).expand(1, *known.shape[1:], 2)
        self._store.add_prior(known, target_au, time_au)
        self._posterior = None

    def add_target(self) -> int:
        """Let a target join that was not known of before. -> its index.

        Measurements still in the window count as not having seen it.
        """
        self._store.add_target()
        self._posterior = None
        return self.num_targets - 1

    def posterior(self, query_au: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Posterior of every target at the same points.

        query_au: (Q, 3) au x, y, t -> mean, std, both (N, Q).
        """
        if self._posterior is None:
            self._posterior = fit(*self._store.window(), kernel=self.kernel)
        query = torch.as_tensor(query_au, dtype=torch.float64)
        mean, std = self._posterior.predict(query)
        return mean[0].numpy(), std[0].numpy()
