"""What pictures and maps have alike: the targets' colours, and round lengths for scales."""

from __future__ import annotations

import math

Rgb = tuple[int, int, int]
TARGET_RGB = (
    (255, 166, 48),
    (77, 196, 255),
    (84, 224, 141),
    (255, 111, 168),
    (255, 225, 77),
    (181, 140, 255),
    (255, 90, 77),
    (53, 214, 200),
)


def target_rgb(index: int) -> Rgb:
    """Colour of the target with this number."""
    return TARGET_RGB[index % len(TARGET_RGB)]


def round_length_m(most_m: float) -> float:
    """The greatest of 1, 2, 5, 10, 20, … m that is no longer than this."""
    power = 10.0 ** math.floor(math.log10(most_m))
    return power * max(factor for factor in (1, 2, 5) if factor * power <= most_m)
