"""The detector that a mission names."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

from dronemon.errors import OptionError
from dronemon.mission import Mission
from dronemon.outside import find_class
from dronemon.vision.blobs import BlobDetector, Look
from dronemon.vision.boxed import BoxDetector, BoxSettings
from dronemon.vision.detector import Detector
from dronemon.vision.drawn import DrawnDetector
from dronemon.vision.markers import MarkerDetector

KINDS = ("drawn", "onnx", "markers", "blobs")


def make_detector(mission: Mission) -> Detector:
    """Finds the mission's targets in its camera's pictures.

    Raises CameraError for a file, a class or a marker that cannot be used, OptionError for a kind.
    """
    of, camera = mission.detector, mission.camera.model
    appearances = [target.appearance for target in mission.targets]
    match of.kind:
        case "drawn":
            return DrawnDetector(appearances, camera, of.min_score)
        case "onnx":
            assert of.file is not None  # mission_problems
            settings = BoxSettings(
                layout=of.layout,
                classes=of.classes,
                input_px=of.input_px,
                tile_px=of.tile_px,
                min_score=of.min_score,
                most_shared=of.most_shared,
            )
            return BoxDetector(Path(of.file), settings, appearances, camera)
        case "markers":
            return MarkerDetector(appearances, camera, family=of.family, side_m=of.side_m)
        case "blobs":
            look = Look(
                hue_deg=of.hue_deg,
                saturation=of.saturation,
                brightness=of.brightness,
                size_m=of.size_m,
                min_score=of.min_score,
            )
            return BlobDetector(appearances[0], camera, look)
    return _outside(mission, appearances)


def _outside(mission: Mission, appearances: list[str]) -> Detector:
    """The detector of a class outside this package."""
    of = mission.detector
    if ":" not in of.kind:
        near = difflib.get_close_matches(of.kind, KINDS, n=1)
        raise OptionError(
            f"there is no detector {of.kind!r}; {''.join(f'did you mean {n}? ' for n in near)}"
            f"there are: {', '.join(KINDS)}, and your own as package.module:Class"
        )
    make = find_class(of.kind, "detector")
    try:
        detector: Any = make(appearances, mission.camera.model, of.min_score)
    except (Exception, SystemExit) as exc:  # a class of others may fail in any way
        raise OptionError(
            f"detector {of.kind!r} cannot be made from appearances, camera and least score: {exc!r}"
        ) from exc
    if not callable(getattr(detector, "detect", None)):
        raise OptionError(f"detector {of.kind!r} has no detect; see docs/detectors.md")
    found: Detector = detector
    return found
