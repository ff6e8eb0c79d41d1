"""What a mission says of its camera, and of how well it knows where that looks."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from dronemon.mission.section import Section
from dronemon.types import CameraModel

Angle = Annotated[float, Field(ge=-180.0, le=180.0)]
Angles = Annotated[tuple[Angle, Angle, Angle], Field(strict=False)]


class PlaceErrors(Section):
    """How far off is what tells the place of a pixel on the ground: one sigma of each."""

    position_m: float = Field(2.0, ge=0.0, le=100.0)
    """Of the vehicle along each axis, where its estimator does not say."""
    height_m: float = Field(1.0, ge=0.0, le=100.0)
    """Of the vehicle's height, where its estimator does not say."""
    ground_m: float = Field(0.5, ge=0.0, le=100.0)
    """Of the ground's height under a target."""
    tilt_deg: float = Field(0.8, ge=0.0, le=20.0)
    """Of the camera's roll and of its pitch, its mounting included."""
    heading_deg: float = Field(1.5, ge=0.0, le=45.0)
    """Of the camera's heading."""
    time_s: float = Field(0.025, ge=0.0, le=2.0)
    """Of a picture's time against the vehicle's."""
    focal_share: float = Field(0.01, ge=0.0, le=0.2)
    """Of the focal length; a data sheet's angle of view is about as good as that."""
    pixel_px: float = Field(1.5, ge=0.0, le=200.0)
    """Of where the detector sees a target, along each axis of the picture."""


class Camera(Section):
    """The downward camera."""

    width_px: int = Field(640, ge=64, le=8192)
    """Width of the pictures."""
    height_px: int = Field(480, ge=64, le=8192)
    """Height of the pictures."""
    url: str = Field(
        "simulated",
        description="`simulated`, or where pictures come from: rtsp://..., udp://..., a video file "
        "(its path from this file) or the number of a local camera.",
    )
    latency_s: float = Field(0.0, ge=0.0, le=5.0)
    """Age of a picture when it arrives; not for the simulated."""
    horizontal_fov_deg: float = Field(90.0, ge=10.0, le=150.0)
    """Angle of view from the left to the right edge; with a calibration, of what is looked at."""
    calibration: str | None = None
    """The lens, a file of `dronemon calibrate intrinsics`, OpenCV or ROS; a pinhole's if absent."""
    mount_deg: Angles = (0.0, 0.0, 0.0)
    """[roll, pitch, yaw] of the camera on drone or gimbal; 0 looks down, its top to the nose."""
    gimbal: bool = False
    """Whether it hangs on a gimbal whose attitude the vehicle tells; else the drone's counts."""
    timeout_s: float = Field(5.0, gt=0.0, le=60.0)
    """Wall-clock wait for a picture."""

    @property
    def is_simulated(self) -> bool:
        """Whether the simulator draws the pictures."""
        return self.url == "simulated"

    @property
    def model(self) -> CameraModel:
        """The pinhole model of this camera."""
        return CameraModel(
            width_px=self.width_px,
            height_px=self.height_px,
            horizontal_fov_rad=math.radians(self.horizontal_fov_deg),
        )
