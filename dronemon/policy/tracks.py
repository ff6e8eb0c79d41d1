"""What sightings say of each target by itself: where it was, which way it went, since when.

The beliefs at the nodes hold all this, but spread over the map and several decisions. Ours, not the
paper's: `NetworkConfig.tracks` shows it to the network.

    B episodes   N targets   T features of a target at one instant
"""

from __future__ import annotations

import torch
from torch import Tensor

from dronemon.mission.schema import SENSOR_RADIUS_AU

NUM_TRACK_FEATURES = 11
"""T: three vectors, then five numbers."""
NUM_TRACK_VECTORS = 3
"""Of T, the pairs that come first and turn with the square; see `Tracks.features`."""
_GAP_AU = 0.35
"""Sightings no further apart belong to one contact, in which a target goes straight."""
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
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
    ) -> None:
        def zeros(*shape: int) -> Tensor:
            return torch.zeros(num_episodes, *shape, dtype=dtype, device=device)

        self._place, self._contact_place = zeros(num_targets, 2), zeros(num_targets, 2)
        self._seen_at, self._contact_at = zeros(num_targets), zeros(num_targets)
        self._velocity, self._missed_at = zeros(num_targets, 2), zeros(num_targets)
        self._is_placed = zeros(num_targets).bool()
        self._has_velocity = zeros(num_targets).bool()
        self._way, self._duration = zeros(), zeros()  # of all contacts, for the targets' speed

    def clear(self, episodes: Tensor) -> None:
        """Forget all about some episodes. episodes: (B,) bool."""
        for value in vars(self).values():
            value[episodes] = 0

    def widen(self, num_targets: int) -> None:
        """Make room for targets that were unknown so far."""
        more = num_targets - self._place.shape[1]
        for name, value in vars(self).items():
            if value.dim() > 1 and more > 0:
                empty = value.new_zeros(len(value), more, *value.shape[2:])
                setattr(self, name, torch.cat([value, empty], dim=1))

    def add_prior(self, known: Tensor, targets: Tensor) -> None:
        """Positions known at time 0. known: (B, N) bool; targets: (B, N, 2)."""
        self._place = torch.where(known[..., None], targets, self._place)
        self._contact_place = torch.where(known[..., None], targets, self._contact_place)
        self._is_placed = self._is_placed | known

    def add(
        self, time: Tensor, agent: Tensor, seen: Tensor, targets: Tensor, active: Tensor
    ) -> None:
        """Take in one measurement.

        time: (B,); agent: (B, 2); seen: (B, N) bool; targets: (B, N, 2), anything where not seen;
        active: (B,) bool, false in episodes that did not measure
        """
        seen = seen & active[:, None]
        now = time[:, None]
        near = (self._expected(now) - agent[:, None]).norm(dim=-1) < SENSOR_RADIUS_AU
        is_missed = near & ~seen & active[:, None] & self._is_placed
        self._missed_at = torch.where(is_missed, now, self._missed_at)

        since = now - self._seen_at
        goes_on = seen & self._is_placed & (since <= _GAP_AU)
        begins = seen & ~goes_on
        step = torch.where(goes_on[..., None], targets - self._place, 0.0).norm(dim=-1)
        self._way = self._way + step.sum(1)
        self._duration = self._duration + torch.where(goes_on, since, 0.0).sum(1)
        # A new contact tells only the mean velocity since the last one.
        drift = (targets - self._place) / since.clamp(min=_BASE_AU)[..., None]
        drift = torch.where(self._is_placed[..., None], drift, 0.0)
        length = now - self._contact_at
        straight = (targets - self._contact_place) / length.clamp(min=_BASE_AU)[..., None]
        is_straight = goes_on & (length >= _BASE_AU)
        self._velocity = torch.where(begins[..., None], drift, self._velocity)
        self._velocity = torch.where(is_straight[..., None], straight, self._velocity)
        self._has_velocity = torch.where(begins, False, self._has_velocity | is_straight)
        self._contact_place = torch.where(begins[..., None], targets, self._contact_place)
        self._contact_at = torch.where(begins, now, self._contact_at)
        self._place = torch.where(seen[..., None], targets, self._place)
        self._seen_at = torch.where(seen, now, self._seen_at)
        self._is_placed = self._is_placed | seen

    def features(self, time: Tensor) -> Tensor:
        """What the network is shown. time: (B,) -> (B, N, T) float32.

        Offset from the square's centre of the place where it was seen last and of the one where it
        is thought to be, velocity; whether the velocity is that of one contact, time since the
        sighting (as a logarithm), how lately it was not where it was thought to be (1: now, 0:
        never), speed of all targets, whether it was ever placed.
        """
        now = time[:, None]
        age = now - self._seen_at
        was_missed = self._missed_at > self._seen_at
        missed = torch.where(was_missed, torch.exp((self._missed_at - now) / _MISSED_AU), 0.0)
        speed = self._way / self._duration.clamp(min=_BASE_AU)
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
        vectors = [self._place - 0.5, self._expected(now) - 0.5, 10.0 * self._velocity]
        shown = torch.cat([*vectors, numbers], dim=-1)
        return torch.where(self._is_placed[..., None], shown, 0.0).float()

    def _expected(self, now: Tensor) -> Tensor:
        """Where targets are thought to be: straight on, for a while. now: (B, 1) -> (B, N, 2)."""
        way = self._velocity * (now - self._seen_at)[..., None]
        length = way.norm(dim=-1, keepdim=True).clamp(min=1e-9)
        expected: Tensor = self._place + way * (_CARRIED_AU / length).clamp(max=1.0)
        return expected.clamp(0.0, 1.0)


def mirrored_tracks(tracks: Tensor, symmetries: Tensor) -> Tensor:
    """Tracks in a turned or mirrored square; see `Graphs.mirrored`. (B, ..., T) -> the same."""
    bits = ((symmetries[:, None] >> torch.arange(3, device=symmetries.device)) & 1).bool()
    size = 2 * NUM_TRACK_VECTORS
    ones = [1] * (tracks.dim() - 2)
    vectors = tracks[..., :size].reshape(*tracks.shape[:-1], NUM_TRACK_VECTORS, 2)
    flipped = torch.where(bits[:, :2].view(-1, *ones, 1, 2), -vectors, vectors)
    turned = torch.where(bits[:, 2].view(-1, *ones, 1, 1), flipped.flip(-1), flipped)
    return torch.cat([turned.flatten(-2), tracks[..., size:]], dim=-1)
