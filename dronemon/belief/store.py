"""Observations and their forgetting: what each Gaussian process is conditioned on.

`ObservationStore` holds many episodes at once, for learning; `Belief` is the single vehicle's view
of one, for flight and planners. Both give the same windows, which a test holds them to.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from dronemon.belief.gp import Posterior, fit
from dronemon.belief.kernel import Matern32
from dronemon.problem import MEASUREMENT_INTERVAL_AU, WINDOW_AU
from dronemon.sightings import Sightings, Window
from dronemon.types import FloatArray

_CAPACITY = math.ceil(WINDOW_AU / MEASUREMENT_INTERVAL_AU)


class ObservationStore:
    """The latest observations of B episodes with N targets each, in tensors that are reused.

    A measurement gives every target one observation: its own position and value 1 where it was
    seen, the agent's position and value 0 where it was not. Each target may have one prior
    observation besides. A new measurement takes the place of the oldest, which no longer counts
    where one is taken every 0.1 au.
    Source: paper, equation 1 and section III-C.
    """

    def __init__(self, batch: int, num_targets: int, *, device: torch.device | str = "cpu") -> None:
        shape = (batch, num_targets, 1 + _CAPACITY)  # slot 0 holds the prior, the others the ring
        self._points = torch.zeros((*shape, 3), dtype=torch.float64, device=device)
        self._values = torch.zeros_like(self._points[..., 0])
        self._is_filled = torch.zeros(shape, dtype=torch.bool, device=device)
        self._measured_au = torch.full_like(self._values[:, 0, 1:], -torch.inf)
        self._rows = torch.arange(batch, device=device)

    def add_prior(self, known: Tensor, target_au: Tensor) -> None:
        """Give places known at time 0. known: (B, N) bool; target_au: (B, N, 2)."""
        self._points[:, :, 0, :2] = target_au
        self._values[:, :, 0] = 1.0
        self._is_filled[:, :, 0] = known

    def add(
        self, time_au: Tensor, agent_au: Tensor, seen: Tensor, target_au: Tensor, active: Tensor
    ) -> None:
        """Add one measurement to each episode.

        time_au:   (B,)      au, not before the episode's last
        agent_au:  (B, 2)    au
        seen:      (B, N)    bool
        target_au: (B, N, 2) au, read where seen
        active:    (B,)      bool; false leaves that episode as it is
        """
        slot = self._measured_au.argmin(dim=1)
        keep = active[:, None]
        ring = (self._rows, slot)
        self._measured_au[ring] = torch.where(active, time_au, self._measured_au[ring])
        place = torch.where(seen[..., None], target_au, agent_au[:, None])  # (B, N, 2)
        point = torch.cat([place, time_au[:, None, None].expand_as(place[..., :1])], dim=-1)
        at = (self._rows, slice(None), 1 + slot)
        self._points[at] = torch.where(keep[..., None], point, self._points[at])
        self._values[at] = torch.where(keep, seen.to(point.dtype), self._values[at])
        self._is_filled[at] |= keep

    def window(self) -> tuple[Tensor, Tensor, Tensor]:
        """Observations that still count at the time of each episode's last measurement.

        -> points (B, N, n, 3) au, values (B, N, n), mask (B, N, n) bool: true where one counts.
        The tensors are the store's own: read them before the next `add`.
        """
        latest_au = self._measured_au.amax(dim=1).clamp_min(0.0)  # (B,)
        age_au = latest_au[:, None, None] - self._points[..., 2]
        return self._points, self._values, self._is_filled & (age_au < WINDOW_AU)


class Belief:
    """What one vehicle believes about all its targets: read off the mission's log of sightings.

    The fit is kept until the log grows. num_imagined: targets believed in, after those known of,
    that were never seen
    """

    def __init__(
        self, sightings: Sightings, kernel: Matern32 | None = None, *, num_imagined: int = 0
    ) -> None:
        self._num_imagined = num_imagined
        self.sightings = sightings
        self.kernel = kernel if kernel is not None else Matern32()
        self._posterior: Posterior | None = None
        self._num_read = -1

    @property
    def num_targets(self) -> int:
        """Targets believed in."""
        return self.sightings.num_targets + self._num_imagined

    @property
    def process(self) -> Posterior:
        """The fitted processes, of shape (1, N)."""
        if self._posterior is None or self._num_read < len(self.sightings):
            window = self.sightings.window(self.kernel.window_au, self.num_targets)
            self._posterior = _fit(window, self.kernel)
            self._num_read = len(self.sightings)
        return self._posterior

    def posterior(self, query_au: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Posterior of every target at the same points.

        query_au: (Q, 3) float64 au x, y, t
        -> mean, std, both (N, Q)
        """
        return _predict(self.process, query_au)

    def posterior_of_now(self) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
        """`posterior` as it is now, whatever is seen later; it is fitted when it is called."""
        window = self.sightings.window(self.kernel.window_au, self.num_targets)
        return lambda query_au: _predict(_fit(window, self.kernel), query_au)

    def mean(self, query_au: FloatArray) -> FloatArray:
        """Posterior mean alone. query_au: (Q, 3) float64 au x, y, t -> (N, Q)."""
        mean = self.process.mean(torch.as_tensor(query_au, dtype=torch.float64))
        return mean[0].numpy()


def _fit(window: Window, kernel: Matern32) -> Posterior:
    points, values, mask = (torch.as_tensor(array)[None] for array in window)
    return fit(points, values, mask, kernel=kernel)


def _predict(process: Posterior, query_au: FloatArray) -> tuple[FloatArray, FloatArray]:
    mean, std = process.predict(torch.as_tensor(query_au, dtype=torch.float64))
    return mean[0].numpy(), std[0].numpy()
