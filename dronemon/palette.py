"""The targets' colours, the same in every picture and on every map."""

from __future__ import annotations

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
