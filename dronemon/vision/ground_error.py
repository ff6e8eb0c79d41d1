"""How far off the place of a pixel on the ground is, from how far off is what tells it.

Errors are passed on to first order: a place has the covariance J S J^T, where J is the derivative
of `Surface.places` and S the covariance of what that is told. Rows of S, columns of J:

    0-2  north, east, height over the ground of the vehicle     m
    3-5  roll, pitch, yaw of the camera                         rad
    6    focal length, as a share of it                         1
    7-8  u, v of the pixel                                      px

Source: Hartley & Zisserman (2004), "Multiple View Geometry in Computer Vision", section 5.2.
"""

from __future__ import annotations

import math

import numpy as np

from dronemon.frames import body_to_ned, pixel_to_ray
from dronemon.mission.camera import PlaceErrors
from dronemon.types import CameraModel, FloatArray, Pose, Vector3
from dronemon.vision.surface import Surface

_WITHIN_95 = math.sqrt(-2.0 * math.log(0.05))
"""Standard deviations of an ellipse that holds 95 of 100 places."""
_FORWARD, _DOWN = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def told_covariance(
    errors: PlaceErrors,
    pose: Pose,
    turn_rad_s: Vector3 = (0.0, 0.0, 0.0),
    accuracy_m: float | None = None,
    height_accuracy_m: float | None = None,
) -> FloatArray:
    """S: of what tells a place. -> (9, 9)

    turn_rad_s:        how fast roll, pitch and yaw change
    accuracy_m:        standard deviation of the vehicle's place along one axis
    height_accuracy_m: of its height; both None where it does not say
    """
    place_m = errors.position_m if accuracy_m is None else accuracy_m
    height_m = errors.height_m if height_accuracy_m is None else height_accuracy_m
    tilt_rad, heading_rad = math.radians(errors.tilt_deg), math.radians(errors.heading_deg)
    each = [place_m, place_m, math.hypot(height_m, errors.ground_m), tilt_rad, tilt_rad]
    each += [heading_rad, errors.focal_share, errors.pixel_px, errors.pixel_px]
    north, east, down = pose.velocity_ned_m_s
    moves = errors.time_s * np.array([north, east, -down, *turn_rad_s, 0.0, 0.0, 0.0])
    covariance: FloatArray = np.diag(np.square(each)) + np.outer(moves, moves)
    return covariance


def ground_covariance(
    pixel_px: FloatArray, camera: CameraModel, pose: Pose, surface: Surface, told: FloatArray
) -> FloatArray:
    """Covariance of the places of pixels on the ground; NaN at or above the horizon.

    pixel_px: (..., 2) u, v
    told:     (9, 9) of what tells them, `told_covariance`
    -> (..., 2, 2) m^2, north and east
    """
    jacobian = ground_jacobian(pixel_px, camera, pose, surface)
    covariance: FloatArray = jacobian @ told @ jacobian.swapaxes(-1, -2)
    return covariance


def ground_jacobian(
    pixel_px: FloatArray, camera: CameraModel, pose: Pose, surface: Surface
) -> FloatArray:
    """J: how the places of pixels on the ground change with what tells them; NaN as the places.

    pixel_px: (..., 2) u, v -> (..., 2, 9) m over the module's units
    """
    rotation = body_to_ned(pose.attitude_rad)
    ray = pixel_to_ray(pixel_px, camera, pose.attitude_rad)
    ray = np.where(ray[..., 2:] > 1e-6, ray, np.nan)
    on_body = ray @ rotation  # forward, right, 1
    heading_rad = pose.attitude_rad[2]
    turns = [
        np.cross(_FORWARD, on_body) @ rotation.T,  # roll is about the nose, as it points
        np.cross([-math.sin(heading_rad), math.cos(heading_rad), 0.0], ray),
        np.cross(_DOWN, ray),
    ]
    lens = [
        (_DOWN - on_body) @ rotation.T,
        np.broadcast_to(rotation[:, 1] / camera.focal_px, ray.shape),
        np.broadcast_to(-rotation[:, 0] / camera.focal_px, ray.shape),
    ]
    by_ray = np.stack([*turns, *lens], axis=-1)  # (..., 3, 6)
    # On flat ground: place = vehicle + height * ray[:2] / ray[2]
    place_m, reach = surface.places(pixel_px, camera, pose), ray[..., :2] / ray[..., 2:]
    height_m = surface.down_m(place_m) - pose.position_ned_m[2]
    moved = by_ray[..., :2, :] - reach[..., None] * by_ray[..., 2:, :]
    moved *= (height_m / ray[..., 2])[..., None, None]
    with_vehicle = np.broadcast_to(np.eye(2), (*reach.shape, 2))
    flat = np.concatenate([with_vehicle, reach[..., None], moved], axis=-1)
    # On a slope s the ground is down by s . d after a step d: on along the ray until it is met.
    slope = surface.slope(place_m)
    met = reach / (1.0 - (slope * reach).sum(axis=-1, keepdims=True))
    jacobian: FloatArray = flat + met[..., None] * (slope[..., None, :] @ flat)
    return jacobian


def radius_m(covariance_m2: FloatArray) -> FloatArray:
    """Radius about a place in which the truth is, in 95 of 100 or more: of all its 95 % ellipse.

    covariance_m2: (..., 2, 2) -> (...)
    """
    north, east = covariance_m2[..., 0, 0], covariance_m2[..., 1, 1]
    largest = 0.5 * (north + east) + np.hypot(0.5 * (north - east), covariance_m2[..., 0, 1])
    radius: FloatArray = _WITHIN_95 * np.sqrt(largest)
    return radius
