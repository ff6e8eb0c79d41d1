"""All conversions: arena <-> local NED <-> latitude/longitude, and pixel <-> ground.

Nothing else converts.

    x_au  along the area's east side      (0.5, 0.5) is its centre; turned by the heading
    y_au  along its north side            down  = ground_down_m - height
    t_au  = t_s * cruise_speed / side     the time in which one au, the square's side, is flown

The local NED origin is the EKF's (asked of the vehicle), which need not be home. A pixel (u, v) has
its origin at the top left corner of the picture; the picture's top points to the vehicle's nose.

A gimbal's axes are ahead of its lens, right and below. Its camera's are those of a vehicle that it
would be screwed to: a gimbal that looks straight down gives roll 0 and pitch 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pymap3d

from dronemon.arena import ARENA, Arena
from dronemon.types import CameraModel, FloatArray, GimbalAttitude, Pose, Vector3

_CAMERA_TO_GIMBAL = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""From top of the picture, right, ahead of the lens to ahead of the lens, right, below."""
_LOCKED = 1e-9
"""Cosine of a pitch at which roll and yaw turn about the same axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GeoPoint:
    """A place on the WGS-84 ellipsoid."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0

    @classmethod
    def at(cls, place_deg: Sequence[float]) -> GeoPoint:
        """The place on the ellipsoid of a latitude and a longitude."""
        latitude_deg, longitude_deg = place_deg
        return cls(latitude_deg=latitude_deg, longitude_deg=longitude_deg)

    def __str__(self) -> str:
        return f"{self.latitude_deg:.6f}, {self.longitude_deg:.6f}"


@dataclass(frozen=True, slots=True, kw_only=True)
class AreaFrame:
    """The monitored area, laid into the vehicle's local NED frame.

    centre_ned_m:  north and east of (0.5, 0.5) au
    ground_down_m: down coordinate of the ground
    side_m:        length of one au
    heading_rad:   clockwise turn of the y axis from north
    arena:         the area in au
    """

    centre_ned_m: tuple[float, float]
    ground_down_m: float
    side_m: float
    heading_rad: float
    cruise_speed_m_s: float
    arena: Arena = ARENA

    @property
    def _axes(self) -> FloatArray:
        """(2, 2): rows are the (north, east) directions of x_au and y_au."""
        s, c = math.sin(self.heading_rad), math.cos(self.heading_rad)
        return np.array([[-s, c], [c, s]])

    def au_to_ned(self, position_au: FloatArray) -> FloatArray:
        """Ground coordinates of places in au.

        Position_au: (..., 2) au -> (..., 2) north, east in m.
        """
        offset_m = (np.asarray(position_au, dtype=np.float64) - 0.5) * self.side_m
        ned: FloatArray = np.asarray(self.centre_ned_m) + offset_m @ self._axes
        return ned

    def ned_to_au(self, position_ned_m: FloatArray) -> FloatArray:
        """Places in au of local points.

        Position_ned_m: (..., 2 or 3) m, down ignored -> (..., 2) au.
        """
        north_east = np.asarray(position_ned_m, dtype=np.float64)[..., :2]
        au: FloatArray = (
            north_east - np.asarray(self.centre_ned_m)
        ) @ self._axes.T / self.side_m + 0.5
        return au

    def au_to_geo(self, position_au: FloatArray, origin: GeoPoint) -> GeoPoint:
        """A place on the area's ground on the globe. position_au: (2,); origin: of the frame."""
        return ned_to_geo([*self.au_to_ned(position_au), self.ground_down_m], origin)

    def s_to_au(self, duration_s: float) -> float:
        """Mission time of a vehicle duration."""
        return duration_s * self.cruise_speed_m_s / self.side_m

    def au_to_s(self, duration_au: float) -> float:
        """Vehicle duration of a mission time."""
        return duration_au * self.side_m / self.cruise_speed_m_s

    def height_m(self, down_m: float) -> float:
        """Height above the ground of a down coordinate."""
        return self.ground_down_m - down_m


def geo_to_ned(point: GeoPoint, origin: GeoPoint) -> FloatArray:
    """Local coordinates of a geographic point. -> (3,) north, east, down in m from `origin`."""
    north, east, down = pymap3d.geodetic2ned(
        point.latitude_deg,
        point.longitude_deg,
        point.altitude_m,
        origin.latitude_deg,
        origin.longitude_deg,
        origin.altitude_m,
    )
    return np.array([north, east, down], dtype=np.float64)


def ned_to_geo(position_ned_m: Sequence[float] | FloatArray, origin: GeoPoint) -> GeoPoint:
    """Geographic point of local coordinates. position_ned_m: (3,) m."""
    latitude, longitude, altitude = pymap3d.ned2geodetic(
        *(float(v) for v in position_ned_m),
        origin.latitude_deg,
        origin.longitude_deg,
        origin.altitude_m,
    )
    return GeoPoint(
        latitude_deg=float(latitude), longitude_deg=float(longitude), altitude_m=float(altitude)
    )


def ned_to_degrees(place_ned_m: FloatArray, origin: GeoPoint) -> FloatArray:
    """Where local places are on the globe. place_ned_m: (..., 2) m -> (..., 2) deg lat, lon."""
    place = np.asarray(place_ned_m, dtype=np.float64)
    latitude, longitude, _ = pymap3d.ned2geodetic(
        place[..., 0],
        place[..., 1],
        np.zeros(place.shape[:-1]),
        origin.latitude_deg,
        origin.longitude_deg,
        origin.altitude_m,
    )
    return np.stack([latitude, longitude], axis=-1)


def degrees_to_ned(places_deg: FloatArray, origin: GeoPoint) -> FloatArray:
    """Local coordinates of places as high as the origin.

    places_deg: (..., 2) deg latitude, longitude
    -> (..., 3) m north, east, down; the earth's curvature makes this more than 0
    """
    places = np.asarray(places_deg, dtype=np.float64)
    north_east_down = pymap3d.geodetic2ned(
        places[..., 0],
        places[..., 1],
        np.full(places.shape[:-1], origin.altitude_m),
        origin.latitude_deg,
        origin.longitude_deg,
        origin.altitude_m,
    )
    return np.stack(north_east_down, axis=-1)


def body_to_ned(attitude_rad: tuple[float, float, float]) -> FloatArray:
    """Rotation matrix from (forward, right, down) to (north, east, down). -> (3, 3)."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a), math.cos(a)) for a in attitude_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def attitude_of(body_to_ned: FloatArray) -> Vector3:
    """Roll, pitch and yaw of a rotation matrix, (3, 3): what `body_to_ned` is told.

    Straight up or down roll and yaw turn about one axis, and roll is taken as none.
    """
    (fn, rn, _), (fe, re, _), (fd, rd, dd) = body_to_ned
    level = math.hypot(rd, dd)
    pitch_rad = math.atan2(-fd, level)
    if level < _LOCKED:
        return 0.0, pitch_rad, math.atan2(-rn, re)
    return math.atan2(rd, dd), pitch_rad, math.atan2(fe, fn)


def quaternion_to_rotation(quaternion: Sequence[float]) -> FloatArray:
    """Rotation matrix, (3, 3), of w, x, y, z with length 1."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def camera_to_ned(gimbal: GimbalAttitude, heading_rad: float) -> FloatArray:
    """Rotation matrix of a gimbal's camera, from top of the picture, right, ahead of the lens.

    heading_rad: the vehicle's yaw at that instant -> (3, 3) to north, east, down
    """
    turned_rad = heading_rad if gimbal.is_from_heading else 0.0
    rotation: FloatArray = body_to_ned((0.0, 0.0, turned_rad)) @ gimbal.rotation @ _CAMERA_TO_GIMBAL
    return rotation


def off_down_rad(camera_to_ned: FloatArray) -> float:
    """Angle between where a camera looks and straight down. camera_to_ned: (3, 3)."""
    return math.acos(min(max(float(camera_to_ned[2, 2]), -1.0), 1.0))


def gimbal_to_camera(gimbal_rad: Vector3) -> Vector3:
    """Attitude of a camera on a gimbal, as of a body from which it would look straight down.

    gimbal_rad: roll, pitch, yaw of where it looks, ZYX: none looks level to the north, a pitch of
    -90 degrees straight down with the picture's top to the yaw
    -> as `Pose.attitude_rad`
    """
    return attitude_of(body_to_ned(gimbal_rad) @ _CAMERA_TO_GIMBAL)


def pixel_to_ray(
    pixel_px: FloatArray, camera: CameraModel, attitude_rad: tuple[float, float, float]
) -> FloatArray:
    """Where pixels look. pixel_px: (..., 2) u, v -> (..., 3) north, east, down, 1 along the axis.

    The camera's axes in the body frame: right of the picture = right, top of the picture = forward,
    optical axis = down.
    """
    pixel = np.asarray(pixel_px, dtype=np.float64)
    forward = (camera.height_px / 2.0 - pixel[..., 1]) / camera.focal_px
    right = (pixel[..., 0] - camera.width_px / 2.0) / camera.focal_px
    ray: FloatArray = (
        np.stack([forward, right, np.ones_like(right)], axis=-1) @ body_to_ned(attitude_rad).T
    )
    return ray


def pixel_to_ground(
    pixel_px: FloatArray, camera: CameraModel, pose: Pose, ground_down_m: float
) -> FloatArray:
    """Where the rays of pixels meet the ground plane; NaN at or above the horizon.

    pixel_px: (..., 2) u, v -> (..., 2) north, east in m.
    """
    ray_ned = pixel_to_ray(pixel_px, camera, pose.attitude_rad)
    height_m = ground_down_m - pose.position_ned_m[2]
    down = ray_ned[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(down > 1e-6, height_m / down, np.nan)
    ground: FloatArray = np.asarray(pose.position_ned_m[:2]) + ray_ned[..., :2] * scale
    return ground


def ground_to_pixel(
    ground_ned_m: FloatArray, camera: CameraModel, pose: Pose, ground_down_m: float
) -> FloatArray:
    """Pixels at which points of the ground plane appear.

    Ground_ned_m: (..., 2) m -> (..., 2) u, v; NaN behind the camera.
    """
    ground = np.asarray(ground_ned_m, dtype=np.float64)
    point = np.concatenate([ground, np.full((*ground.shape[:-1], 1), ground_down_m)], axis=-1)
    forward, right, down = np.moveaxis(
        (point - np.asarray(pose.position_ned_m)) @ body_to_ned(pose.attitude_rad), -1, 0
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(down > 1e-6, camera.focal_px / down, np.nan)
    pixel: FloatArray = np.stack(
        [camera.width_px / 2.0 + right * scale, camera.height_px / 2.0 - forward * scale], axis=-1
    )
    return pixel
