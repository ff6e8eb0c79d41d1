"""Cameras: where pictures come from."""

from dronemon.camera.simulated import SimulatedCamera
from dronemon.camera.source import FrameSource

__all__ = ["FrameSource", "SimulatedCamera"]
