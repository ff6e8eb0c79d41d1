"""The simulator's own network: what it learns from, how it learns, and what its file says."""

from __future__ import annotations

import itertools
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from dronemon.frames import AreaFrame
from dronemon.mission.detector import DetectorSection
from dronemon.types import APPEARANCES, Pose
from dronemon.vision.boxed import BoxDetector
from sim.detector.network import DetectorNetwork, export, loss_of
from sim.detector.pictures import CAMERA, Labelled, Pictures, labels
from sim.random_scene import random_scene
from sim.scene import Animal, Scene

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
    assert (heat == 1.0).sum() >= 2


@pytest.mark.parametrize(
    ("heading_deg", "width_px", "height_px"),
    # A bus of 12 by 2.5 m, at 10 pixels a metre, below a drone that looks north.
    [(0.0, 25.0, 120.0), (90.0, 120.0, 25.0), (30.0, 81.7, 116.4), (-30.0, 81.7, 116.4)],
)
def test_boxes_stand_upright_about_what_lies_aslant(
    heading_deg: float, width_px: float, height_px: float
):
    bus = Animal(
        name="bus",
        appearance="bus-red",
        position_ned_m=(0.0, 0.0),
        heading_rad=math.radians(heading_deg),
        walked_m=0.0,
    )
    frame = AreaFrame(
        centre_ned_m=(0.0, 0.0),
        ground_down_m=-3.0,
        side_m=200.0,
        heading_rad=0.0,
        cruise_speed_m_s=5.0,
    )
    _, boxes = labels(Scene(pose=POSE, frame=frame, animals=(bus,)))
    sides_px = 16.0 * boxes[2:, 30, 40].exp()
    assert sides_px.tolist() == pytest.approx([width_px, height_px], abs=3.0)


@pytest.mark.lengthy
def test_a_short_training_leaves_a_network_that_can_be_flown_and_its_card(tmp_path: Path):
    out = tmp_path / "new" / "detector.onnx"
    options = ["--minutes", "0.05", "--workers", "0", "--seed", "3", "--out", out]
    done = subprocess.run(
        [sys.executable, "-m", "sim.detector", *map(str, options)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "pictures, loss" in done.stdout
    section = DetectorSection(kind="onnx", file=str(out))
    detector = BoxDetector(section, APPEARANCES, CAMERA)
    assert detector.detect(np.zeros((480, 640, 3), np.uint8), POSE, 0.0) == ()
    page = out.with_suffix(".md").read_text()
    assert f"`python -m sim.detector --minutes 0.05 --seed 3 --workers 0 --out {out}`" in page
    assert re.search(r"\| 0\.1 \| \d+ \| \d", page), "the last row is the end"


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("option", "value", "why"),
    [
        ("--minutes", "0", "no time to train"),
        ("--minutes", "nan", "no time to train"),
        ("--workers", "-1", "is not 0 or more"),
        ("--out", "/dev/null/detector.onnx", "error: --out /dev/null/"),
        ("--out", "detector.md", "ends in .onnx"),
        ("--minutes", "inf", "no time to train"),
    ],
)
def test_what_cannot_be_trained_is_told_at_once(option: str, value: str, why: str):
    options = {"--minutes": "60", "--out": "/dev/null/x.onnx", option: value}
    words = [word for pair in options.items() for word in pair]
    done = subprocess.run(
        [sys.executable, "-m", "sim.detector", *words], capture_output=True, text=True
    )
    assert done.returncode == 2
    assert why in done.stderr
    assert "Traceback" not in done.stderr


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
    network = DetectorNetwork().train()
    shown, heat, boxes = pictures[0]
    shown, wanted = shown[None, :, :240, :320], (heat[None, :, :30, :40], boxes[None, :, :30, :40])
    optimiser = torch.optim.Adam(network.parameters(), 3e-3)
    losses = []
    for _ in range(15):
        loss = loss_of(network(shown), *wanted)
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
    network = DetectorNetwork()
    with torch.no_grad():
        network.head.weight.zero_()
        network.head.bias.fill_(-9.0)
        network.head.bias[:4] = torch.tensor([0.25, -0.25, 0.0, math.log(2.0)])
        network.head.bias[4 + APPEARANCES.index("zebra")] = 3.0
    path = tmp_path / "detector.onnx"
    export(network, path, CAMERA.width_px, CAMERA.height_px)
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
