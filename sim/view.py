"""The projection of a simulated picture.

It is built here from a camera matrix and elementary rotations, on purpose without
`dronemon.frames`: two independent derivations cannot share a sign error.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from dronemon.types import CameraModel, FloatArray, Pose

MIN_HEIGHT_M = 0.2
NEAREST = 0.05
"""What is nearer along the optical axis than this part of the height is not drawn."""
_ANIMAL_REACH_M = 8.0


class View:
    """The projection of one picture. Ground points are (north, east) in m from the vehicle."""

    def __init__(self, camera: CameraModel, pose: Pose, ground_down_m: float) -> None:
        focal_px = 0.5 * camera.width_px / math.tan(0.5 * camera.horizontal_fov_rad)
        # Array indices: a pixel's index is that of its centre, half a pixel from its edge.
        self._intrinsics = np.array(
            [
                [focal_px, 0.0, 0.5 * (camera.width_px - 1)],
                [0.0, focal_px, 0.5 * (camera.height_px - 1)],
                [0.0, 0.0, 1.0],
            ]
        )
        roll, pitch, yaw = pose.attitude_rad
        ned_from_body = _turn(2, yaw) @ _turn(1, pitch) @ _turn(0, roll)
        # The camera's x is the body's right, its y the body's back, its z the body's down.
        body_from_camera = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        self._camera_from_ned = (ned_from_body @ body_from_camera).T
        self.size_px = np.array([camera.width_px, camera.height_px])
        self.north_east_m = pose.position_ned_m[:2]
        self.height_m = max(ground_down_m - pose.position_ned_m[2], MIN_HEIGHT_M)
        self.px_per_m = focal_px / self.height_m

    def homography(self, plane_height_m: float) -> FloatArray:
        """-> (3, 3) from (north, east, 1) on a plane above the ground to (column, row, 1) depth."""
        below = np.diag([1.0, 1.0, self.height_m - plane_height_m])
        homography: FloatArray = self._intrinsics @ self._camera_from_ned @ below
        return homography

    def is_near(self, north_m: float, east_m: float, up_m: float) -> bool:
        """Whether something of an animal's size there can show in the picture."""
        point = self.homography(up_m) @ np.array([north_m, east_m, 1.0])
        if point[2] < NEAREST * self.height_m:
            return False
        margin_px = _ANIMAL_REACH_M * self.px_per_m * self.height_m / point[2]
        pixel = point[:2] / point[2]
        return bool(np.all((pixel > -margin_px) & (pixel < self.size_px + margin_px)))

    def down_per_pixel(self) -> FloatArray:
        """-> (3,) so that its product with (column, row, 1) is positive below the horizon."""
        down: FloatArray = (self._camera_from_ned.T @ np.linalg.inv(self._intrinsics))[2]
        return down


def _turn(axis: int, angle_rad: float) -> FloatArray:
    """Right-handed rotation about one axis. -> (3, 3)"""
    vector = np.zeros(3)
    vector[axis] = angle_rad
    return np.asarray(cv2.Rodrigues(vector)[0], np.float64)
