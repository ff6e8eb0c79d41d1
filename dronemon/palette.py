"""What pictures and maps have alike: colours of targets and beliefs, and lengths of scales."""

from __future__ import annotations

import math

import numpy as np

from dronemon.types import FloatArray, ImageArray

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
FOG_RGB = np.array([[14, 18, 26], [96, 106, 122]], dtype=np.float64)
"""Ground of a belief map where every target's standard deviation is 0, and where it is 1."""
_DARKEN = 0.8


def target_rgb(index: int) -> Rgb:
    """Colour of the target with this number."""
    return TARGET_RGB[index % len(TARGET_RGB)]


def on_paper(index: int) -> tuple[float, float, float]:
    """The same for white ground, darker. -> red, green, blue from 0 to 1"""
    red, green, blue = (_DARKEN * part / 255.0 for part in target_rgb(index))
    return red, green, blue


def belief_rgb(mean: FloatArray, std: FloatArray) -> ImageArray:
    """Picture of all beliefs at once. mean, std: (N, G, G) -> (G, G, 3) uint8."""
    fog = np.clip(std, 0.0, 1.0).mean(axis=0)[..., None]
    rgb = FOG_RGB[0] + (FOG_RGB[1] - FOG_RGB[0]) * fog
    for index, presence in enumerate(np.clip(mean, 0.0, 1.0)):
        rgb += (np.array(target_rgb(index)) - rgb) * 0.9 * presence[..., None]
    image: ImageArray = rgb.astype(np.uint8)
    return image


def round_length_m(most_m: float) -> float:
    """The greatest of 1, 2, 5, 10, 20, … m that is no longer than this."""
    power = 10.0 ** math.floor(math.log10(most_m))
    return power * max(factor for factor in (1, 2, 5) if factor * power <= most_m)
