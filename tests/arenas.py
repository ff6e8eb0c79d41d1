"""Fields of other forms than the square."""

from __future__ import annotations

import numpy as np

from dronemon.arena import Arena


def star(num_corners: int, rng: np.random.Generator, *, centre, reach) -> np.ndarray:
    """A polygon that is seen whole from its centre, and seldom convex. -> (n, 2)."""
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, num_corners))
    angle = 0.5 * angle + np.pi * np.arange(num_corners) / num_corners
    away = reach * rng.uniform(0.35, 1.0, num_corners)
    return centre + away[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def drawn_arena(seed: int) -> Arena:
    rng = np.random.default_rng(seed)
    border = star(int(rng.integers(5, 14)), rng, centre=(0.5, 0.5), reach=0.8)
    zones = [
        star(int(rng.integers(3, 8)), rng, centre=rng.uniform(0.1, 0.9, 2), reach=0.3)
        for _ in range(int(rng.integers(0, 5)))
    ]
    return Arena.polygon(border, zones, margin_au=float(rng.choice([0.0, 0.02])))


U = Arena.polygon(
    np.array(
        [
            [0.0, 0.0],
            [1.0, 0.0],
            [1.0, 1.0],
            [0.7, 1.0],
            [0.7, 0.3],
            [0.3, 0.3],
            [0.3, 1.0],
            [0.0, 1.0],
        ]
    )
)
"""A U: from the top of one arm to the top of the other one flies down and up again."""
HOLED = Arena.polygon(
    np.array([[-0.2, 0.0], [1.1, 0.1], [1.4, 0.9], [0.4, 1.2], [-0.1, 0.8]]),
    [
        np.array([[0.2, 0.3], [0.6, 0.25], [0.5, 0.8]]),
        np.array([[0.9, 0.5], [1.1, 0.5], [1.1, 0.7], [0.9, 0.7]]),
    ],
    margin_au=0.02,
)
"""With two no-fly zones, and a part outside the square."""
