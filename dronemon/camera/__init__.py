"""Cameras: where pictures come from."""

from dronemon.camera.crops import CropKeeper, crop_path
from dronemon.camera.posed import PosedCamera, PosedPictures, has_poses, read_posed
from dronemon.camera.rectified import RectifiedCamera
from dronemon.camera.simulated import SimulatedCamera
from dronemon.camera.source import FrameSource, Freshness, check_picture, check_size
from dronemon.camera.video import VideoCamera

__all__ = [
    "CropKeeper",
    "FrameSource",
    "Freshness",
    "PosedCamera",
    "PosedPictures",
    "RectifiedCamera",
    "SimulatedCamera",
    "VideoCamera",
    "check_picture",
    "check_size",
    "crop_path",
    "has_poses",
    "read_posed",
]
