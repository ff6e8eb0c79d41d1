"""Cameras: where pictures come from."""

from dronemon.camera.simulated import SimulatedCamera
from dronemon.camera.source import FrameSource, check_picture
from dronemon.camera.video import VideoCamera

__all__ = ["FrameSource", "SimulatedCamera", "VideoCamera", "check_picture"]
