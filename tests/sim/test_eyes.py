"""The simulator's own network: what it learns from, how it learns, and what its file says."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from dronemon.mission.detector import DetectorSection
from dronemon.types import APPEARANCES, Pose
from dronemon.vision.boxed import BoxDetector
from sim.eyes.network import Eyes, export, loss_of
from sim.eyes.pictures import CAMERA, Labelled, Pictures, labels
from sim.random_scene import random_scene

POSE = Pose(
    time_s=0.0,
    position_ned_m=(0.0, 0.0, -35.0),
    velocity_ned_m_s=(0.0, 0.0, 0.0),
    attitude_rad=(0.0, 0.0, 0.0),
)


@pytest.fixture(scope="module")
def pictures() -> list[Labelled]:
    return list(itertools.islice(Pictures(seed=10000, num_worlds=1), 4))


def test_labels_are_where_the_targets_are():
    """Seen from straight above, where the pixel of a place needs no code of the application's."""
    scene = random_scene(np.random.default_rng(10000), 32.0, num_near=8, max_tilt_rad=0.0)
    heat, boxes = labels(scene)
    assert heat.shape == (len(APPEARANCES), 60, 80)
    for animal in scene.animals:
        away_m = np.subtract(animal.position_ned_m, scene.pose.position_ned_m[:2])
        yaw = scene.pose.attitude_rad[2]
        ahead_m = away_m @ [math.cos(yaw), math.sin(yaw)]
        aside_m = away_m @ [-math.sin(yaw), math.cos(yaw)]
        u, v = 320.0 + 10.0 * aside_m, 240.0 - 10.0 * ahead_m
        if not (0.0 < u < 640.0 and 0.0 < v < 480.0):
            continue
        row, column = int(v // 8), int(u // 8)
        assert heat[APPEARANCES.index(animal.appearance), row, column] == 1.0
        off_px = 8.0 * boxes[:2, row, column].numpy()
        assert 8.0 * (column + 0.5) + off_px[0] == pytest.approx(u, abs=0.5)
        assert 8.0 * (row + 0.5) + off_px[1] == pytest.approx(v, abs=0.5)
        sides_px = 16.0 * boxes[2:, row, column].exp().numpy()
        # Animals are 3 to 6 m long, at 10 pixels a metre, and thin; the box stands upright.
        assert 20.0 < sides_px.max() < 65.0
        assert sides_px.min() > 11.9
    assert (heat == 1.0).sum() >= 2


def test_pictures_are_alike_for_a_seed_and_no_two_are(pictures: list[Labelled]):
    again = list(itertools.islice(Pictures(seed=10000, num_worlds=1), 2))
    for one, other in zip(pictures, again, strict=False):
        assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))
    assert not torch.equal(pictures[0].picture, pictures[1].picture)
    for labelled in pictures:
        assert labelled.picture.shape == (3, 480, 640)
        assert 0.0 <= labelled.picture.min() < labelled.picture.max() <= 1.0


def test_it_learns_a_picture_by_heart(pictures: list[Labelled]):
    torch.manual_seed(0)
    eyes = Eyes().train()
    shown, heat, boxes = pictures[0]
    shown, wanted = shown[None, :, :240, :320], (heat[None, :, :30, :40], boxes[None, :, :30, :40])
    optimiser = torch.optim.Adam(eyes.parameters(), 3e-3)
    losses = []
    for _ in range(15):
        loss = loss_of(eyes(shown), *wanted)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.7 * losses[0]


def test_what_the_loss_wants_has_none_of_it(pictures: list[Labelled]):
    _, heat, boxes = pictures[0]
    logits = torch.where(heat == 1.0, 20.0, -20.0)
    perfect = torch.cat([boxes, logits])[None]
    assert loss_of(perfect, heat[None], boxes[None]) < 1e-3
    astray = torch.roll(perfect, 3, dims=3)
    assert loss_of(astray, heat[None], boxes[None]) > 10.0


def test_its_file_tells_size_and_names_and_its_boxes_lie_where_the_network_says(tmp_path: Path):
    eyes = Eyes()
    with torch.no_grad():
        eyes.head.weight.zero_()
        eyes.head.bias.fill_(-9.0)
        eyes.head.bias[:4] = torch.tensor([0.25, -0.25, 0.0, math.log(2.0)])
        eyes.head.bias[4 + APPEARANCES.index("zebra")] = 3.0
    path = tmp_path / "eyes.onnx"
    export(eyes, path, CAMERA.width_px, CAMERA.height_px)
    section = DetectorSection(kind="onnx", file=str(path), most_shared=1.0)
    found = BoxDetector(section, ("zebra",), CAMERA).detect(
        np.zeros((480, 640, 3), np.uint8), POSE, 0.0
    )
    assert len(found) == 300, "as many as it keeps: all cells say zebra"
    for detection in found:
        assert detection.appearance == "zebra"
        assert detection.score == pytest.approx(1.0 / (1.0 + math.exp(-3.0)), abs=1e-4)
        u, v = detection.pixel_px
        assert (u - 6.0) % 8.0 == pytest.approx(0.0, abs=1e-3)
        assert (v - 2.0) % 8.0 == pytest.approx(0.0, abs=1e-3)
        left, top, right, bottom = detection.box_px
        assert (right - left, bottom - top) == pytest.approx((16.0, 32.0), abs=1e-3)
