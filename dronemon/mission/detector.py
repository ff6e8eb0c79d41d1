"""What a mission says of its detector."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from dronemon.mission.section import Fraction, Section
from dronemon.types import Layout

Pixel = Annotated[int, Field(ge=32, le=8192)]
Pixels = Annotated[tuple[Pixel, Pixel], Field(strict=False)]
Hue = Annotated[float, Field(ge=0.0, le=360.0)]
Hues = Annotated[tuple[Hue, Hue], Field(strict=False)]
Size = Annotated[float, Field(gt=0.0, le=1000.0)]
Sizes = Annotated[tuple[Size, Size], Field(strict=False)]
KEYS_OF_KIND = {
    "onnx": ("file", "classes", "layout", "input_px", "tile_px", "most_shared"),
    "markers": ("family", "side_m"),
    "blobs": ("hue_deg", "saturation", "brightness", "size_m"),
}
"""Keys that only one kind has."""
KINDS = ("drawn", *KEYS_OF_KIND)


class DetectorSection(Section):
    """How targets are found in pictures; most keys are for one kind."""

    kind: str = "drawn"
    """drawn (the simulator's animals), onnx, markers, blobs, or package.module:Class."""
    min_score: Fraction = 0.5
    """Detections less certain than this are dropped."""
    confusion: dict[str, dict[str, Fraction]] = Field(
        default={},
        description="Appearances that are taken for others: {horse: {cow: 0.1}} if one horse of "
        "ten is found as a cow.",
    )
    needed_px_per_m: float | None = Field(None, gt=0.0, le=1000.0)
    """Least size of a metre on the picture; drawn has its own, the others none if absent."""
    file: str | None = None
    """onnx: the network's file, its path from this one."""
    classes: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """onnx: all that the network was trained for, in order; none where the file tells."""
    layout: Layout | None = None
    """onnx: of the network's output; told from its shape if absent."""
    input_px: Pixels | None = None
    """onnx: [width, height] of its input, where the file leaves it open."""
    tile_px: int | None = Field(None, ge=64, le=8192)
    """onnx: side of the parts in which it is shown a picture; all at once if absent."""
    most_shared: Fraction = 0.5
    """onnx: share of area in common from which two boxes are of one target."""
    family: str = "apriltag_36h11"
    """markers: their set, by OpenCV's name, such as 4x4_50 or apriltag_16h5."""
    side_m: float | None = Field(None, gt=0.0, le=100.0)
    """markers: side of the black square, a check on each find; none if absent."""
    hue_deg: Hues | None = None
    """blobs: [from, to] round the circle of hues: red 0, green 120, blue 240; any if absent."""
    saturation: Fraction = 0.0
    """blobs: least saturation of the colour."""
    brightness: Fraction = 0.0
    """blobs: least brightness; a thermal camera's warmth."""
    size_m: Sizes = (0.2, 5.0)
    """blobs: [least, greatest] root of the area on the ground."""

    @field_validator("confusion")
    @classmethod
    def _are_shares(cls, confusion: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
        for look, taken in confusion.items():
            if look in taken:
                raise ValueError(f"says how often {look} is found as itself; that is the rest")
            if sum(taken.values()) >= 1.0:
                raise ValueError(f"leaves nothing of {look}; shares add up to less than 1")
        return confusion

    @field_validator("classes")
    @classmethod
    def _are_different(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(names)) < len(names):
            raise ValueError("has a class twice")
        return names

    @field_validator("size_m")
    @classmethod
    def _is_rising(cls, size_m: tuple[float, float]) -> tuple[float, float]:
        if size_m[0] > size_m[1]:
            raise ValueError(f"is {list(size_m)}; the least comes first")
        return size_m

    @field_validator("hue_deg")
    @classmethod
    def _is_a_part(cls, hue_deg: tuple[float, float] | None) -> tuple[float, float] | None:
        if hue_deg is not None and (hue_deg[1] - hue_deg[0]) % 360.0 == 0.0:
            raise ValueError(f"is {list(hue_deg)}, one hue alone; leave it out for any")
        return hue_deg
