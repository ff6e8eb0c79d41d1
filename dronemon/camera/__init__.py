"""Cameras: where pictures come from."""

from dronemon.camera.simulated import SimulatedCamera
from dronemon.camera.source import FrameSource
from dronemon.camera.video import VideoCamera

__all__ = ["FrameSource", "SimulatedCamera", "VideoCamera"]
