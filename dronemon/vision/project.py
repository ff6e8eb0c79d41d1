"""Between picture and ground: the pose at a picture's instant, the size of what is seen."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from dronemon.errors import CameraError
from dronemon.frames import attitude_of, body_to_ned, camera_to_ned, off_down_rad, pixel_to_ground
from dronemon.types import CameraModel, FloatArray, GimbalAttitude, Pose, Vector3

_MOST_OFF_DOWN_DEG = 20.0
"""By which a gimbal may look off straight down and its pictures still count."""


def interpolate_pose(before: Pose, after: Pose, time_s: float) -> Pose:
    """The pose at an instant between two others.

    Angles turn the shorter way round. Outside the interval the nearer pose moves on with its
    velocity and keeps its attitude.
    """
    if time_s <= before.time_s:
        return _moved(before, time_s)
    if time_s >= after.time_s:
        return _moved(after, time_s)
    t = (time_s - before.time_s) / (after.time_s - before.time_s)
    turn = np.subtract(after.attitude_rad, before.attitude_rad)
    attitude = np.add(before.attitude_rad, t * _wrapped(turn))
    return Pose(
        time_s=time_s,
        position_ned_m=_between(before.position_ned_m, after.position_ned_m, t),
        velocity_ned_m_s=_between(before.velocity_ned_m_s, after.velocity_ned_m_s, t),
        attitude_rad=_vector(_wrapped(attitude)),
    )


def on_gimbal(pose: Pose, before: GimbalAttitude, after: GimbalAttitude) -> Pose:
    """The pose of a vehicle with the attitude of its gimbal's camera, between two of the gimbal's.

    Raises CameraError where that looks elsewhere than down.
    """
    heading_rad, time_s = pose.attitude_rad[2], pose.time_s
    rotation = camera_to_ned(before, heading_rad)
    if after.time_s > before.time_s:
        both = Rotation.from_matrix(np.stack([rotation, camera_to_ned(after, heading_rad)]))
        turn = Slerp([before.time_s, after.time_s], both)
        rotation = turn(np.clip(time_s, before.time_s, after.time_s)).as_matrix()
    if (off_deg := math.degrees(off_down_rad(rotation))) > _MOST_OFF_DOWN_DEG:
        raise CameraError(
            f"the gimbal looks {off_deg:.0f} degrees off straight down, {_MOST_OFF_DOWN_DEG:g} are "
            "the limit; has somebody turned it, or is it stuck?"
        )
    return replace(pose, attitude_rad=attitude_of(rotation))


def ground_below_m(pose: Pose, range_m: float) -> float:
    """Down coordinate of ground that a vehicle's rangefinder, fixed to its body, looks at."""
    return pose.position_ned_m[2] + range_m * float(body_to_ned(pose.attitude_rad)[2, 2])


def turning(before: Pose, after: Pose) -> Vector3:
    """How fast roll, pitch and yaw change between two poses, in rad/s; 0 where no time passes."""
    passed_s = after.time_s - before.time_s
    if passed_s <= 0.0:
        return 0.0, 0.0, 0.0
    return _vector(_wrapped(np.subtract(after.attitude_rad, before.attitude_rad)) / passed_s)


def _moved(pose: Pose, time_s: float) -> Pose:
    step_m = np.multiply(pose.velocity_ned_m_s, time_s - pose.time_s)
    position = _vector(np.add(pose.position_ned_m, step_m))
    return replace(pose, time_s=time_s, position_ned_m=position)


def _between(start: Vector3, end: Vector3, t: float) -> Vector3:
    return _vector((1.0 - t) * np.array(start) + t * np.array(end))


def _wrapped(angles_rad: FloatArray) -> FloatArray:
    """The same angles from -pi up to pi."""
    wrapped: FloatArray = (angles_rad + math.pi) % (2.0 * math.pi) - math.pi
    return wrapped


def _vector(values: FloatArray) -> Vector3:
    x, y, z = (float(v) for v in values)
    return x, y, z


def shown_radius_m(camera: CameraModel, pose: Pose, ground_down_m: float) -> float:
    """Radius about the point below the vehicle in which a picture shows all the ground."""
    across = camera.width_px / 2.0 / camera.focal_px
    along = camera.height_px / 2.0 / camera.focal_px
    # Normals, to the inside, of the planes through the lens and an edge: forward, right, down.
    on_body = np.array([[0, 1, across], [0, -1, across], [1, 0, along], [-1, 0, along]])
    normals = on_body @ body_to_ned(pose.attitude_rad).T
    height_m = ground_down_m - pose.position_ned_m[2]
    with np.errstate(divide="ignore"):
        away_m = height_m * normals[:, 2] / np.hypot(normals[:, 0], normals[:, 1])
    return max(0.0, float(away_m.min()))


def ground_side_m(
    corners_px: FloatArray, camera: CameraModel, pose: Pose, ground_down_m: float
) -> float:
    """Side of the square that covers as much ground as a quadrangle; NaN beyond the horizon.

    corners_px: (4, 2) u, v
    """
    ground_m = pixel_to_ground(corners_px, camera, pose, ground_down_m)
    return math.sqrt(cv2.contourArea((ground_m - ground_m[0]).astype(np.float32)))
