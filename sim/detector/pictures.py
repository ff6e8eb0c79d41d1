"""Pictures to learn from: random worlds, light, blur and noise, and where each target is."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from dronemon.frames import ground_to_pixel
from dronemon.mission.camera import Camera
from dronemon.mission.schema import Simulation
from dronemon.types import (
    ANIMALS,
    APPEARANCES,
    PEOPLE,
    VEHICLES,
    FloatArray,
    ImageArray,
)
from sim.camera import decode, encode
from sim.detector.network import STEP_PX, box_rows
from sim.random_scene import random_scene
from sim.renderer import Renderer
from sim.scene import Animal, Scene
from sim.sprites import drawn_size_m

CAMERA = Camera().model
"""A mission's default."""
FIRST_SEED = 20000
"""Of the worlds; those of `benchmarks/vision.py` are others."""
LOWEST_M, HIGHEST_M = 16.0, 100.0
HIGHEST_OF_GROUP_M = {ANIMALS: 58.0, PEOPLE: 35.0, VEHICLES: math.inf}
"""Heights up to which a group shows enough to be told."""
_PICTURES_PER_WORLD = 40
_LEAST_SIDE_PX = 12.0
_LEAST_SIGMA_PX, _SIGMA = 0.6 * STEP_PX, 0.15
"""Width of a target's heat: at least, and over the smaller side of its box."""
_MAX_TILT_RAD = math.radians(25.0)


class Labelled(NamedTuple):
    """A picture, and what the network is to make of it.

    picture: (3, height, width)         RGB from 0 to 1
    heat:    (C, height / 8, width / 8) 1 at a target's centre, falling to 0 about it
    boxes:   (4, height / 8, width / 8) the hottest target's, 0 where there is none
    """

    picture: Tensor
    heat: Tensor
    boxes: Tensor


class Pictures(IterableDataset[Labelled]):
    """Labelled pictures without end, others from every worker."""

    def __init__(self, seed: int = FIRST_SEED, num_worlds: int = 8) -> None:
        """num_worlds: in which pictures are taken by turns, until others take their place."""
        self._seed, self._num_worlds = seed, num_worlds

    def __iter__(self) -> Iterator[Labelled]:
        cv2.setNumThreads(1)
        worker = get_worker_info()
        seed = self._seed + (1000 * worker.id if worker else 0)
        rng = np.random.default_rng(seed)
        count = self._num_worlds
        worlds = [_world(rng, seed + number) for number in range(count)]
        for number in itertools.count(count):
            for _ in range(_PICTURES_PER_WORLD):
                yield _labelled(rng, *worlds[rng.integers(count)])
            worlds[number % count] = _world(rng, seed + number)


def _world(rng: np.random.Generator, seed: int) -> tuple[Renderer, int]:
    """Ground, light, clouds and shutter; and the quality of the JPEG. A third is kind in each."""

    def perhaps(kind: float, unkind: float) -> float:
        return kind if rng.random() < 1 / 3 else unkind

    simulation = Simulation(
        light=perhaps(1.0, 2.0 ** -rng.uniform(0.0, 4.0)),
        shadow=perhaps(0.0, rng.uniform(0.1, 0.7)),
        exposure_s=perhaps(0.0, rng.uniform(0.0, 0.03)),
        jpeg_quality=int(perhaps(95, rng.uniform(35, 96))),
    )
    return Renderer(CAMERA, seed, simulation), simulation.jpeg_quality


def _labelled(rng: np.random.Generator, renderer: Renderer, quality: int) -> Labelled:
    scene = _scene(rng)
    image = decode(encode(renderer.render(scene), quality))
    heat, boxes = labels(scene)
    return Labelled(_shown(image, rng), heat, boxes)


def _shown(image: ImageArray, rng: np.random.Generator) -> Tensor:
    """The picture as the network sees it, with a white balance and an exposure a little off."""
    gains = torch.from_numpy(rng.uniform(0.85, 1.15) * rng.uniform(0.95, 1.05, 3)).float()
    picture = torch.from_numpy(image[..., ::-1].copy()).permute(2, 0, 1).float() / 255.0
    return (picture * gains[:, None, None]).clamp(0.0, 1.0)


def _scene(rng: np.random.Generator) -> Scene:
    """Some or many of all that a height shows, near a drone that moves and turns."""
    height_m = math.exp(rng.uniform(math.log(LOWEST_M), math.log(HIGHEST_M)))
    shown = [
        name for group, most_m in HIGHEST_OF_GROUP_M.items() if height_m < most_m for name in group
    ]
    number = int(rng.integers(2, 2 * len(shown)))
    scene = random_scene(
        rng,
        height_m,
        appearances=tuple(rng.permutation(2 * shown)[:number].tolist()),
        reach=2.0,
        num_near=number,
        max_tilt_rad=_MAX_TILT_RAD,
    )
    way, turn = rng.uniform(0.0, math.tau, 2)
    speed_m_s, turn_rad_s = rng.uniform(0.0, 10.0), rng.uniform(0.0, 0.4)
    pose = replace(
        scene.pose,
        velocity_ned_m_s=(speed_m_s * math.cos(way), speed_m_s * math.sin(way), 0.0),
    )
    rates = (turn_rad_s * math.cos(turn), turn_rad_s * math.sin(turn), 0.0)
    return replace(scene, pose=pose, turn_rad_s=rates)


def labels(scene: Scene) -> tuple[Tensor, Tensor]:
    """What the network is to put out for a scene. -> (C, h, w), (4, h, w)"""
    columns, rows = CAMERA.width_px // STEP_PX, CAMERA.height_px // STEP_PX
    heat, boxes = torch.zeros(len(APPEARANCES), rows, columns), torch.zeros(4, rows, columns)
    hottest = torch.zeros(rows, columns)
    down, across = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    for animal in scene.animals:
        (u, v), (width_px, height_px) = (part.tolist() for part in _box(scene, animal))
        if not (0.0 < u < CAMERA.width_px and 0.0 < v < CAMERA.height_px):
            continue
        right_px, down_px = u - STEP_PX * (across + 0.5), v - STEP_PX * (down + 0.5)
        sigma_px = max(_LEAST_SIGMA_PX, _SIGMA * min(width_px, height_px))
        own = torch.exp(-0.5 * (right_px**2 + down_px**2) / sigma_px**2)
        own[int(v // STEP_PX), int(u // STEP_PX)] = 1.0
        number = APPEARANCES.index(animal.appearance)
        heat[number] = torch.maximum(heat[number], own)
        boxes = torch.where(own > hottest, box_rows(right_px, down_px, width_px, height_px), boxes)
        hottest = torch.maximum(hottest, own)
    return heat, boxes


def _box(scene: Scene, animal: Animal) -> tuple[FloatArray, FloatArray]:
    """Where a target's foot is on the picture, and the sides of a box about it, in pixels."""
    length_m, width_m, _ = drawn_size_m(animal.appearance)
    s, c = math.sin(animal.heading_rad), math.cos(animal.heading_rad)
    box_m = 0.5 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * (length_m, width_m)
    corners_m = np.array(animal.position_ned_m) + box_m @ np.array([[c, s], [-s, c]])
    points_m = np.vstack([animal.position_ned_m, corners_m])
    pixels = ground_to_pixel(points_m, CAMERA, scene.pose, scene.frame.ground_down_m)
    return pixels[0], np.ptp(pixels[1:], axis=0).clip(_LEAST_SIDE_PX, CAMERA.width_px)
