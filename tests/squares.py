"""A network that finds coloured squares, exported by torch as detectors are, in every layout."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d

from dronemon.types import ImageArray

BGR = {"red": (20, 20, 240), "blue": (240, 20, 20)}
CLASSES = tuple(BGR)
SIDE_PX, _STEP_PX = 24, 8


class Squares(nn.Module):
    """Looks for squares of SIDE_PX; how much of one is of a colour is its score."""

    def __init__(
        self, layout: str, size_px: tuple[int, int], *, is_grey: bool = False, gain: float = 1.0
    ) -> None:
        super().__init__()
        self._layout, self._is_grey, self._gain = layout, is_grey, gain
        across, down = (
            torch.arange(0, length - SIDE_PX + 1, _STEP_PX) + SIDE_PX / 2 for length in size_px
        )
        y, x = torch.meshgrid(down, across, indexing="ij")
        side = torch.full_like(x, SIDE_PX)
        self.places = torch.stack([x, y, side, side], dim=-1).reshape(1, -1, 4).float()
        self.shares = self.places / torch.tensor([*size_px, *size_px])

    def forward(self, picture: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        """(1, channels, height, width) 0 to 1 -> outputs of the layout."""
        means = avg_pool2d(picture, SIDE_PX, _STEP_PX)
        if self._is_grey:
            colours = torch.cat([means, 0.0 * means], dim=1)
        else:
            red, green, blue = means.chunk(3, dim=1)
            colours = torch.cat([red - 0.5 * (green + blue), blue - 0.5 * (red + green)], dim=1)
        chances = colours.flatten(2).transpose(1, 2).clamp(1e-4, 1.0 - 1e-4)
        chances = self._gain * chances  # (1, n, 2)
        match self._layout:
            case "yolov5":
                things = torch.ones_like(chances[..., :1])
                return torch.cat([self.places, things, chances], dim=2)
            case "yolov8":
                places = self.places.expand(len(chances), -1, -1)
                return torch.cat([places, chances], dim=2).transpose(1, 2)
            case "yolov10":
                centres, half = self.places[..., :2], 0.5 * self.places[..., 2:]
                score, number = chances.max(dim=2, keepdim=True)
                return torch.cat([centres - half, centres + half, score, number.float()], dim=2)
            case "rtdetr":
                return torch.cat([self.shares, chances], dim=2)
            case "rtdetr-top":
                score, number = chances.max(dim=2, keepdim=True)
                return torch.cat([self.shares, score, number.float()], dim=2)
        return (chances / (1.0 - chances)).log(), self.shares + 0.0 * chances[..., :1]


def write_squares(
    path: Path,
    layout: str = "yolov8",
    size_px: tuple[int, int] = (320, 320),
    *,
    is_grey: bool = False,
    names: object = dict(enumerate(CLASSES)),
    batch: int = 1,
    gain: float = 1.0,
) -> Path:
    """Write such a network's file.

    names: what its metadata says of its classes, None for none; gain: of its scores
    """
    network = Squares(layout, size_px, is_grey=is_grey, gain=gain).eval()
    picture = torch.zeros(batch, 1 if is_grey else 3, *size_px[::-1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch's newer exporter takes a hundred times as long
        torch.onnx.export(network, (picture,), path, dynamo=False, input_names=["images"])
    if names is not None:
        model = onnx.load(path)
        onnx.helper.set_model_props(model, {"names": str(names), "task": json.dumps("detect")})
        onnx.save(model, path)
    return path


def draw_squares(
    size_px: tuple[int, int], side_px: int, *squares: tuple[str, int, int]
) -> ImageArray:
    """A grey picture with squares: colour, and u, v of the centre."""
    width, height = size_px
    image = np.full((height, width, 3), 90, np.uint8)
    half = side_px // 2
    for colour, u, v in squares:
        image[v - half : v + half, u - half : u + half] = BGR[colour]
    return image
