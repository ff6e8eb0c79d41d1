"""What sightings say of each target by itself: where it was, which way it went, since when.

The beliefs at the nodes hold all this, but spread over the map and several decisions. Ours, not the
paper's: `NetworkConfig.tracks` shows it to the network.

    B episodes   N targets   T features of a target at one instant
"""

from __future__ import annotations

import torch
from torch import Tensor

from dronemon.arena import ARENA
from dronemon.problem import SENSOR_RADIUS_AU

NUM_TRACK_FEATURES = 11
"""T: three vectors, then five numbers."""
NUM_TRACK_VECTORS = 3
"""Of T, the pairs that come first and turn with the square; see `Tracks.features`."""
_GAP_AU = 0.35
"""Sightings no further apart belong to one contact, in which a target is thought to go straight.

Of a contact that lasts longer the latest part counts.
"""
_BASE_AU = 0.05
"""A contact this long gives a velocity."""
_CARRIED_AU = 0.15
"""A target is thought to go straight on for this long a way, about that to its next turn."""
_MISSED_AU = 1.0
"""Length over which it is forgotten that a target was not where it was thought to be."""


class Tracks:
    """Follows the targets of B episodes through what the sensor says.

    All times and places are in au; `seen` of targets that do not exist must be false.
    """

    def __init__(
        self,
        num_episodes: int,
        num_targets: int,
        *,
        device: torch.device | str = "cpu",
    ) -> None:
        def zeros(*shape: int) -> Tensor:
            return torch.zeros(num_episodes, *shape, dtype=torch.float64, device=device)

        self._place_au, self._contact_place_au = zeros(num_targets, 2), zeros(num_targets, 2)
        self._seen_at_au, self._contact_at_au = zeros(num_targets), zeros(num_targets)
        self._velocity, self._missed_at_au = zeros(num_targets, 2), zeros(num_targets)
        self._is_placed = zeros(num_targets).bool()
        self._has_velocity = zeros(num_targets).bool()
        # Of all contacts, for the targets' speed:
        self._way_au, self._duration_au = zeros(), zeros()
        self._low_au, self._high_au = torch.as_tensor(ARENA.bounds).to(device)
        self._centre_au = 0.5 * (self._low_au + self._high_au)

    def widen(self, num_targets: int) -> None:
        """Make room for targets that were unknown so far."""
        more = num_targets - self._place_au.shape[1]
        for name, value in vars(self).items():
            if value.dim() > 1 and more > 0:
                empty = value.new_zeros(len(value), more, *value.shape[2:])
                setattr(self, name, torch.cat([value, empty], dim=1))

    def add_prior(self, known: Tensor, targets_au: Tensor) -> None:
        """Positions known at time 0. known: (B, N) bool; targets_au: (B, N, 2)."""
        self._place_au = torch.where(known[..., None], targets_au, self._place_au)
        self._contact_place_au = torch.where(known[..., None], targets_au, self._contact_place_au)
        self._is_placed = self._is_placed | known

    def add(
        self,
        time_au: Tensor,
        agent_au: Tensor,
        seen: Tensor,
        targets_au: Tensor,
        active: Tensor,
        view_au: float = SENSOR_RADIUS_AU,
    ) -> None:
        """Take in one measurement.

        time_au: (B,); agent_au: (B, 2); seen: (B, N) bool; targets_au: (B, N, 2), anything where
        not seen; active: (B,) bool, false in episodes that did not measure; view_au: how far about
        the agent was looked at
        """
        seen = seen & active[:, None]
        now_au = time_au[:, None]
        near = (self._expected(now_au) - agent_au[:, None]).norm(dim=-1) < view_au
        is_missed = near & ~seen & active[:, None] & self._is_placed
        self._missed_at_au = torch.where(is_missed, now_au, self._missed_at_au)

        since = now_au - self._seen_at_au
        goes_on = seen & self._is_placed & (since <= _GAP_AU)
        begins = seen & ~goes_on
        step = torch.where(goes_on[..., None], targets_au - self._place_au, 0.0).norm(dim=-1)
        self._way_au = self._way_au + step.sum(1)
        self._duration_au = self._duration_au + torch.where(goes_on, since, 0.0).sum(1)
        # A new contact tells only the mean velocity since the last one.
        drift = (targets_au - self._place_au) / since.clamp(min=_BASE_AU)[..., None]
        drift = torch.where(self._is_placed[..., None], drift, 0.0)
        is_long = goes_on & (now_au - self._contact_at_au > _GAP_AU)
        self._contact_place_au = torch.where(
            is_long[..., None], self._place_au, self._contact_place_au
        )
        self._contact_at_au = torch.where(is_long, self._seen_at_au, self._contact_at_au)
        length = now_au - self._contact_at_au
        straight = (targets_au - self._contact_place_au) / length.clamp(min=_BASE_AU)[..., None]
        is_straight = goes_on & (length >= _BASE_AU)
        self._velocity = torch.where(begins[..., None], drift, self._velocity)
        self._velocity = torch.where(is_straight[..., None], straight, self._velocity)
        self._has_velocity = torch.where(begins, False, self._has_velocity | is_straight)
        self._contact_place_au = torch.where(begins[..., None], targets_au, self._contact_place_au)
        self._contact_at_au = torch.where(begins, now_au, self._contact_at_au)
        self._place_au = torch.where(seen[..., None], targets_au, self._place_au)
        self._seen_at_au = torch.where(seen, now_au, self._seen_at_au)
        self._is_placed = self._is_placed | seen

    def features(self, time_au: Tensor) -> Tensor:
        """What the network is shown. time_au: (B,) -> (B, N, T) float32.

        Offset from the arena's centre of the place where it was seen last and of the one where it
        is thought to be, ten times the velocity; whether the velocity is that of one contact, time
        since the sighting (as a logarithm), how lately it was not where it was thought to be (1:
        now, 0: never), ten times the speed of all targets, whether it was ever placed.
        """
        now_au = time_au[:, None]
        age = now_au - self._seen_at_au
        was_missed = self._missed_at_au > self._seen_at_au
        missed = torch.where(was_missed, torch.exp((self._missed_at_au - now_au) / _MISSED_AU), 0.0)
        speed = self._way_au / self._duration_au.clamp(min=_BASE_AU)
        numbers = torch.stack(
            [
                self._has_velocity.to(age.dtype),
                torch.log1p(age),
                missed,
                10.0 * speed[:, None].expand_as(age),
                self._is_placed.to(age.dtype),
            ],
            dim=-1,
        )
        expected_au = self._expected(now_au)
        vectors = [
            self._place_au - self._centre_au,
            expected_au - self._centre_au,
            10.0 * self._velocity,
        ]
        shown = torch.cat([*vectors, numbers], dim=-1)
        return torch.where(self._is_placed[..., None], shown, 0.0).float()

    def _expected(self, now_au: Tensor) -> Tensor:
        """Where targets are thought to be: straight on, for a while.

        now_au: (B, 1) -> (B, N, 2).
        """
        way = self._velocity * (now_au - self._seen_at_au)[..., None]
        length = way.norm(dim=-1, keepdim=True).clamp(min=1e-9)
        expected = self._place_au + way * (_CARRIED_AU / length).clamp(max=1.0)
        clipped: Tensor = expected.clamp(self._low_au, self._high_au)
        return clipped


def mirrored_tracks(tracks: Tensor, symmetries: Tensor) -> Tensor:
    """Tracks in a turned or mirrored square; see `Graphs.mirrored`. (B, ..., T) -> the same.

    The one thing here that another arena than a square would end: it has not these symmetries.
    """
    bits = ((symmetries[:, None] >> torch.arange(3, device=symmetries.device)) & 1).bool()
    size = 2 * NUM_TRACK_VECTORS
    ones = [1] * (tracks.dim() - 2)
    vectors = tracks[..., :size].reshape(*tracks.shape[:-1], NUM_TRACK_VECTORS, 2)
    flipped = torch.where(bits[:, :2].view(-1, *ones, 1, 2), -vectors, vectors)
    turned = torch.where(bits[:, 2].view(-1, *ones, 1, 1), flipped.flip(-1), flipped)
    return torch.cat([turned.flatten(-2), tracks[..., size:]], dim=-1)
