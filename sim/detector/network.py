"""The network: pictures to a box and a chance of every class, for each of their 8 by 8 pixels.

Fully convolutional, and small enough for one core. It is trained as CenterNet is: the cell that
holds a target's centre is to say what it is and where. Source: Zhou, Wang and Krähenbühl, "Objects
as Points", 2019.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.functional import logsigmoid, smooth_l1_loss

from dronemon.types import APPEARANCES

STEP_PX = 8
"""Side of a cell."""
_SIDE_PX = 16.0
"""Side of a box that the network makes of zeros."""
_PRIOR_LOGIT = -4.6
"""Of a target in a cell before training: one in a hundred."""
_BOX_WEIGHT, _BOX_BETA = 0.05, 0.1
"""Of the boxes in the loss, and where their error turns from squared to absolute."""
_LEAST_HEAT = 0.3
"""Where a target's heat is above this, a cell tells its box, too."""


def _layer(before: int, after: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(before, after, 3, stride, dilation, dilation, bias=False),
        nn.BatchNorm2d(after),
        nn.ReLU(inplace=True),
    )


class DetectorNetwork(nn.Module):
    """(B, 3, height, width) RGB from 0 to 1 -> (B, 4 + C, height / 8, width / 8)

    Rows: how far the centre is from the cell's, in cells; logs of the box's sides over 16 pixels;
    a logit for each of `APPEARANCES`.
    """

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            _layer(3, 16, stride=2),
            _layer(16, 32, stride=2),
            _layer(32, 64, stride=2),
            _layer(64, 64),
            _layer(64, 64, dilation=2),
            _layer(64, 64, dilation=3),
        )
        self.head = nn.Conv2d(64, 4 + len(APPEARANCES), 1)
        nn.init.zeros_(self.head.weight[:4])
        assert self.head.bias is not None
        nn.init.constant_(self.head.bias[4:], _PRIOR_LOGIT)

    def forward(self, pictures: Tensor) -> Tensor:
        """Boxes and logits of every cell."""
        out: Tensor = self.head(self.layers(pictures))
        return out


class _Boxes(nn.Module):
    """The network, which puts out boxes in pixels as YOLOv8 does: (1, 4 + C, cells)."""

    def __init__(self, network: DetectorNetwork, width_px: int, height_px: int) -> None:
        super().__init__()
        self._network = network
        down, across = torch.meshgrid(
            torch.arange(height_px // STEP_PX), torch.arange(width_px // STEP_PX), indexing="ij"
        )
        self._cells = STEP_PX * (torch.stack([across, down])[None] + 0.5)

    def forward(self, picture: Tensor) -> Tensor:
        """One picture's boxes."""
        out = self._network(picture)
        centres = self._cells + STEP_PX * out[:, :2]
        sides = _SIDE_PX * out[:, 2:4].exp()
        return torch.cat([centres, sides, out[:, 4:].sigmoid()], dim=1).flatten(2)


def loss_of(out: Tensor, heat: Tensor, boxes: Tensor) -> Tensor:
    """Penalty-reduced focal loss of the classes, and error of the boxes.

    out:   (B, 4 + C, h, w) of the network
    heat:  (B, C, h, w)     1 where a target's centre is, falling to 0 about it
    boxes: (B, 4, h, w)     the box of the hottest target, as the network puts it out
    """
    logits = out[:, 4:]
    chance, is_centre = logits.sigmoid(), heat == 1.0
    found = -((1.0 - chance) ** 2) * logsigmoid(logits) * is_centre
    astray = -((1.0 - heat) ** 4) * chance**2 * logsigmoid(-logits)
    number = is_centre.sum().clamp(min=1)
    hottest = heat.amax(dim=1, keepdim=True)
    weight = hottest * (hottest > _LEAST_HEAT)
    off = smooth_l1_loss(out[:, :4], boxes, reduction="none", beta=_BOX_BETA) * weight
    return (found + astray).sum() / number + _BOX_WEIGHT * off.sum() / number


def box_rows(right_px: Tensor, down_px: Tensor, width_px: float, height_px: float) -> Tensor:
    """Boxes as the network puts them out.

    right_px, down_px: (h, w) of a box's centre from each cell's -> (4, h, w)
    """
    sides = torch.tensor([width_px, height_px]) / _SIDE_PX
    rows = sides.log()[:, None, None].expand(2, *right_px.shape)
    return torch.cat([torch.stack([right_px, down_px]) / STEP_PX, rows])


def export(network: DetectorNetwork, path: Path, width_px: int, height_px: int) -> None:
    """Write an ONNX file that says its input's size and the names of its classes."""
    import onnx  # of the tests' packages: who flies needs none

    picture = torch.zeros(1, 3, height_px, width_px)
    whole = _Boxes(network.eval(), width_px, height_px).eval()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch's newer exporter needs another package
        torch.onnx.export(whole, (picture,), path, dynamo=False, input_names=["images"])
    model = onnx.load(path)
    onnx.helper.set_model_props(model, {"names": str(dict(enumerate(APPEARANCES)))})
    onnx.save(model, path)
