"""Eyes: animals in pictures, and what they mean for the binary sensor."""

from dronemon.vision.detector import Detector
from dronemon.vision.observe import observe
from dronemon.vision.project import interpolate_pose

__all__ = ["Detector", "interpolate_pose", "observe"]
