"""How good a belief is, measured where the targets truly are.

    sigma_bar  mean standard deviation over a target's area
    Unc        mean of sigma_bar over targets and instants
    JSD        Jensen-Shannon divergence of the belief from a bump at the true position, in nats
    MinOb      observations of the target that was observed least
    lost       whether sigma_bar > 0.9

Source: paper, sections IV-A.3 and V-A.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dronemon.arena import ARENA, Arena
from dronemon.belief.gp import Posterior, fit
from dronemon.belief.grid import EvaluationGrid, evaluation_grid
from dronemon.belief.kernel import Matern32
from dronemon.hindsight import Hindsight
from dronemon.problem import (
    LOST_STD,
    PRESENCE_STD_AU,
    SENSOR_RADIUS_AU,
    Prior,
)
from dronemon.sensor import PERFECT, Sensor
from dronemon.sightings import told
from dronemon.types import BoolArray, FloatArray

_JSD_FLOOR = 1e-8
_INSTANTS_AT_ONCE = 16
"""Instants of an episode scored together; bounds the memory and stays in cache."""


def area_std(
    posterior: Posterior, targets_au: Tensor, time_au: Tensor, grid: EvaluationGrid
) -> Tensor:
    """Mean posterior standard deviation over each target's area: sigma_bar.

    posterior: of shape (...); targets_au: (..., 2) true positions; time_au: (...) au -> (...).
    """
    points, is_inside = grid.target_area(targets_au)
    time = time_au[..., None, None].expand_as(points[..., :1])
    std = posterior.std(torch.cat([points, time], dim=-1))
    return torch.where(is_inside, std, 0.0).sum(-1) / is_inside.sum(-1)


def jensen_shannon(mean: Tensor, targets_au: Tensor, grid: EvaluationGrid) -> Tensor:
    """JSD between beliefs and unit bumps at the true positions.

    mean: (..., Q) posterior mean on the grid; targets_au: (..., 2) au -> (...) in [0, ln 2] nat.
    """
    bump = grid.bumps(targets_au, PRESENCE_STD_AU)
    p, q = _normalised(bump), _normalised(mean.clamp_min(0.0))
    middle = 0.5 * (p + q)
    return 0.5 * (p * (p / middle).log() + q * (q / middle).log()).sum(-1)


def _normalised(weight: Tensor) -> Tensor:
    """Distribution over the grid, nowhere zero. (..., Q) -> (..., Q)."""
    raised = weight + _JSD_FLOOR
    return raised / raised.sum(-1, keepdim=True)


def peak_error_au(mean: Tensor, targets_au: Tensor, grid: EvaluationGrid) -> Tensor:
    """Distance from the belief's highest grid point to the target; NaN where no mean is positive.

    mean: (..., Q) posterior mean on the grid; targets_au: (..., 2) au -> (...) au.
    """
    height, index = mean.max(dim=-1)
    peak_au = grid.points_au.to(mean)[index]
    error_au = torch.linalg.vector_norm(peak_au - targets_au, dim=-1)
    return torch.where(height > 0.0, error_au, torch.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scores:
    """One episode in a few figures; means are over all its measurement instants.

    unc:           mean of sigma_bar over targets
    unc_std:       standard deviation of sigma_bar between targets
    lost:          fraction with sigma_bar > 0.9
    min_ob:        observations of the target observed least
    jsd:           nat
    since_seen_au: time since a target was last seen
    peak_error_au: of beliefs that have a peak; NaN if none ever had
    """

    unc: float
    unc_std: float
    lost: float
    min_ob: int
    jsd: float
    since_seen_au: float
    peak_error_au: float


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeMetrics:
    """Every metric of every target at every instant; index 0 is before the first measurement.

    unc: (S+1, N) sigma_bar; jsd: (S+1, N) nat; peak_error_au: (S+1, N), NaN without a peak;
    since_seen_au: (S+1, N), counted from the start before the first sight; observed: (S+1, N) bool,
    said to be seen, and in view.
    """

    unc: FloatArray
    jsd: FloatArray
    peak_error_au: FloatArray
    since_seen_au: FloatArray
    observed: BoolArray

    @property
    def scores(self) -> Scores:
        """The episode's figures, over its measurements."""
        unc, has_peak = self.unc[1:], np.isfinite(self.peak_error_au[1:])
        errors_au = self.peak_error_au[1:][has_peak]
        return Scores(
            unc=float(unc.mean()),
            unc_std=float(unc.std(axis=1).mean()),
            lost=float((unc > LOST_STD).mean()),
            min_ob=int(self.observed[1:].sum(axis=0).min()),
            jsd=float(self.jsd[1:].mean()),
            since_seen_au=float(self.since_seen_au[1:].mean()),
            peak_error_au=float(errors_au.mean()) if errors_au.size else math.nan,
        )


def episode_metrics(
    time_au: FloatArray,
    agent_au: FloatArray,
    targets_au: FloatArray,
    told_au: FloatArray,
    *,
    prior: Prior = "full",
    kernel: Matern32 | None = None,
    arena: Arena = ARENA,
    sensor: Sensor = PERFECT,
) -> EpisodeMetrics:
    """Score the belief that a recorded episode led to, at every instant.

    time_au:    (S+1,)      au, increasing; index 0 is the start, the others the measurements
    agent_au:   (S+1, 2)    au
    targets_au: (S+1, N, 2) au, true positions
    told_au:    (S+1, N, 2) au, where the target was said to be seen, NaN where not; 0 is ignored
    sensor:     how the eye erred that said so
    """
    observed = _truly_seen(agent_au, targets_au, told_au)
    kernel = kernel if kernel is not None else Matern32()
    history = _History.of(time_au, agent_au, targets_au, told_au, prior, sensor, kernel.window_au)
    grid = evaluation_grid(arena)
    unc, jsd, error_au = (torch.empty(observed.shape, dtype=torch.float64) for _ in range(3))
    for start in range(0, len(time_au), _INSTANTS_AT_ONCE):
        block = torch.arange(start, min(start + _INSTANTS_AT_ONCE, len(time_au)))
        posterior = fit(*history.windows(block), kernel=kernel)  # (block, N)
        now_au, truth_au = history.time_au[block], history.targets_au[block]
        unc[block] = area_std(
            posterior, truth_au, now_au[:, None].expand(truth_au.shape[:-1]), grid
        )
        instant_au = now_au[:, None, None].expand(-1, len(grid.points_au), 1)
        query = torch.cat([grid.points_au.expand(len(block), -1, -1), instant_au], dim=-1)
        mean = posterior.mean(query[:, None])  # (block, N, Q)
        jsd[block] = jensen_shannon(mean, truth_au, grid)
        error_au[block] = peak_error_au(mean, truth_au, grid)
    return EpisodeMetrics(
        unc=unc.numpy(),
        jsd=jsd.numpy(),
        peak_error_au=error_au.numpy(),
        since_seen_au=since_seen_au(time_au, observed),
        observed=observed,
    )


def _truly_seen(agent_au: FloatArray, targets_au: FloatArray, told_au: FloatArray) -> BoolArray:
    """Which targets were said to be seen, and were in view. -> (S+1, N)"""
    offset_au = targets_au - agent_au[:, None]
    distance_au = np.sqrt(offset_au[..., 0] ** 2 + offset_au[..., 1] ** 2)
    seen: BoolArray = ~np.isnan(told_au[..., 0]) & (distance_au < SENSOR_RADIUS_AU)
    return seen


def since_seen_au(time_au: FloatArray, observed: BoolArray) -> FloatArray:
    """Time since each target was last seen, or since the start.

    time_au: (S+1,) au; observed: (S+1, N) bool -> (S+1, N) au.
    """
    seen_au = np.where(observed, time_au[:, None], time_au[0])
    since: FloatArray = time_au[:, None] - np.maximum.accumulate(seen_au, axis=0)
    return since


@dataclass(frozen=True, slots=True, kw_only=True)
class _History:
    """A recorded episode as observations, so that any instant's window can be cut out of it.

    time_au: (S+1,); agent_au: (S+1, 2); targets_au: (S+1, N, 2); told_au: (S+1, N, 2) what each
    instant told, NaN where a target was not seen, the prior first; believed_au: (S+1, n, N, 2)
    what each instant made of itself and those before it, none where the eye does not err;
    is_known: (S+1, N) whether the target is believed in; has_prior: (N,); window_au: how long an
    instant counts.
    """

    time_au: Tensor
    agent_au: Tensor
    targets_au: Tensor
    told_au: Tensor
    believed_au: Tensor | None
    is_known: Tensor
    has_prior: Tensor
    window_au: float

    @classmethod
    def of(
        cls,
        time_au: FloatArray,
        agent_au: FloatArray,
        targets_au: FloatArray,
        told_au: FloatArray,
        prior: Prior,
        sensor: Sensor,
        window_au: float,
    ) -> _History:
        """Read what each measurement told about each target; index 0 holds the prior."""
        prior_au = targets_au[:1] if prior == "full" else np.full_like(targets_au[:1], np.nan)
        told_au = np.concatenate([prior_au, told_au[1:]])
        seen = ~np.isnan(told_au[..., 0])
        known = np.maximum.accumulate(seen, axis=0) | (prior == "number")
        believed_au = _believed(time_au, agent_au, told_au, known, sensor, window_au)
        return cls(
            time_au=torch.as_tensor(time_au),
            agent_au=torch.as_tensor(agent_au),
            targets_au=torch.as_tensor(targets_au),
            told_au=torch.as_tensor(told_au),
            believed_au=None if believed_au is None else torch.as_tensor(believed_au),
            is_known=torch.as_tensor(known),
            has_prior=torch.as_tensor(seen[0]),
            window_au=window_au,
        )

    def windows(self, instants: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Observations that count at some instants.

        instants: (T,) -> points (T, N, n, 3), values (T, N, n), mask (T, N, n).
        """
        begin = torch.searchsorted(self.time_au, self.time_au[instants] - self.window_au)
        width = int((instants - begin).amax()) + 1
        index = instants[:, None] - torch.arange(width)  # (T, n), the newest first
        age_au = self.time_au[instants, None] - self.time_au[index.clamp_min(0)]
        counts = (index >= 0) & (age_au < self.window_au)
        index = index.clamp_min(0)
        is_real = (index > 0)[:, None] | self.has_prior[:, None]  # (T, N, n)
        mask = counts[:, None] & is_real & self.is_known[instants][..., None]
        if self.believed_au is None:
            told_au = self.told_au[index]
        else:
            told_au = self.believed_au[instants, :width]
        seen = ~told_au[..., 0].isnan()  # (T, n, N)
        place = torch.where(seen[..., None], told_au, self.agent_au[index][:, :, None])
        time = self.time_au[index][..., None, None].expand_as(place[..., :1])
        points = torch.cat([place, time], dim=-1).transpose(1, 2)
        return points, seen.transpose(1, 2).to(points.dtype), mask


def _believed(
    time_au: FloatArray,
    agent_au: FloatArray,
    told_au: FloatArray,
    known: BoolArray,
    sensor: Sensor,
    window_au: float,
) -> FloatArray | None:
    """What each instant made of itself and those before it. -> (S+1, n, N, 2), newest first"""
    if not sensor.needs_hindsight:
        return None
    begin = np.searchsorted(time_au, time_au - window_au)
    width = int((np.arange(len(time_au)) - begin).max()) + 1
    hindsight = Hindsight(sensor, told_au[0])
    believed_au = np.full((len(told_au), width, *told_au.shape[1:]), np.nan)
    believed_au[0, 0] = told_au[0]
    for now in range(1, len(told_au)):
        look = told(float(time_au[now]), agent_au[now], told_au[now])
        hindsight.add(look, int(known[now].sum()))
        first = max(0, now - width)
        believed_au[now, : now - first] = hindsight.believed_au(first)[::-1]
        if now < width:
            believed_au[now, now] = told_au[0]
    return believed_au
