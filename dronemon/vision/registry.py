"""The detector that a mission names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dronemon.errors import OptionError, did_you_mean
from dronemon.mission import Mission
from dronemon.mission.detector import KINDS, DetectorSection
from dronemon.outside import find_class
from dronemon.types import CameraModel
from dronemon.vision.blobs import BlobDetector
from dronemon.vision.boxed import BoxDetector
from dronemon.vision.detector import Detector
from dronemon.vision.drawn import DrawnDetector
from dronemon.vision.markers import MarkerDetector


def make_detector(mission: Mission) -> Detector:
    """Finds the mission's targets in its camera's pictures.

    Raises OptionError for a kind, a file, a class or a marker that cannot be used.
    """
    of = mission.detector
    own = [target.appearance for target in mission.targets]
    others = [other for taken in of.confusion.values() for other in taken]
    return detector_of(of, list(dict.fromkeys(own + others)), mission.camera.model)


def detector_of(of: DetectorSection, appearances: Sequence[str], camera: CameraModel) -> Detector:
    """Finds what looks so in a camera's pictures. Raises as `make_detector`."""
    match of.kind:
        case "drawn":
            return DrawnDetector(appearances, camera, of.min_score)
        case "onnx":
            return BoxDetector(of, appearances, camera)
        case "markers":
            return MarkerDetector(of, appearances, camera)
        case "blobs":
            return BlobDetector(of, appearances[0], camera)
    return _outside(of, appearances, camera)


def _outside(of: DetectorSection, appearances: Sequence[str], camera: CameraModel) -> Detector:
    """The detector of a class outside this package."""
    kind = of.kind
    if ":" not in kind:
        raise OptionError(
            f"kind {kind!r}: there is no such detector; {did_you_mean(kind, KINDS)}"
            f"there are: {', '.join(KINDS)}, and your own as package.module:Class"
        )
    make = find_class(kind, "detector")
    try:
        detector: Any = make(appearances, camera, of.min_score)
    except (Exception, SystemExit) as exc:  # a class of others may fail in any way
        raise OptionError(
            f"detector {kind!r} cannot be made from appearances, camera and least score: {exc!r}"
        ) from exc
    if not callable(getattr(detector, "detect", None)):
        raise OptionError(f"detector {kind!r} has no detect; see docs/detectors.md")
    found: Detector = detector
    return found
