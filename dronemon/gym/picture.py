"""Pictures of episodes for `render`: beliefs, the agent and what it sees, where targets are."""

from __future__ import annotations

import numpy as np
import torch

from dronemon.arena import ARENA
from dronemon.belief import fit
from dronemon.env import Env, Observation
from dronemon.palette import belief_rgb, target_rgb
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import FloatArray, ImageArray

_CELLS, _CELL_PX = 40, 8
_DOT_AU, _LINE_AU = 0.012, 0.004
_WHITE = (255, 255, 255)


def draw(env: Env, seen: Observation, num_targets: int) -> list[ImageArray]:
    """Pictures of B episodes, north up.

    Of each target its belief's mean, and a dot where it truly is; darker ground where less is in
    doubt; the sensor's circle about the agent.
    """
    cells = torch.as_tensor(ARENA.cells(_CELLS, _CELLS))
    time_au = seen.length_au[:, None, None].expand(-1, len(cells), 1)
    query = torch.cat([cells.expand(len(time_au), -1, -1), time_au], dim=-1)
    posterior = fit(*env.observations()).predict(query[:, None])
    mean, std = (
        x[:, :num_targets].reshape(-1, num_targets, _CELLS, _CELLS).numpy() for x in posterior
    )
    agents_au, targets_au = seen.position_au.numpy(), env.targets_au.numpy()
    return [
        _picture(mean[b], std[b], agents_au[b], targets_au[b, :num_targets])
        for b in range(len(mean))
    ]


def _picture(
    mean: FloatArray, std: FloatArray, agent_au: FloatArray, targets_au: FloatArray
) -> ImageArray:
    """One episode. mean, std: (N, cells along x, along y); targets_au: (N, 2)."""
    size = _CELLS * _CELL_PX
    places_au = ARENA.cells(size, size).reshape(size, size, 2)
    picture = belief_rgb(mean, std).repeat(_CELL_PX, axis=0).repeat(_CELL_PX, axis=1)
    for number, target_au in enumerate(targets_au):
        distance_au = np.linalg.norm(places_au - target_au, axis=-1)
        picture[distance_au < _DOT_AU + _LINE_AU] = _WHITE
        picture[distance_au < _DOT_AU] = target_rgb(number)
    distance_au = np.linalg.norm(places_au - agent_au, axis=-1)
    is_agent = (np.abs(distance_au - SENSOR_RADIUS_AU) < _LINE_AU) | (distance_au < _DOT_AU)
    picture[is_agent] = _WHITE
    north_up: ImageArray = np.ascontiguousarray(picture.swapaxes(0, 1)[::-1])
    return north_up
