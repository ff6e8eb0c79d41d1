"""The flight in three dimensions and on the globe.

scene/ground         the belief of all targets, laid on the ground
scene/area           its border
scene/vehicle        where the drone is and how it is tilted, with its camera's view
scene/seen/NAME      where a target was seen last
world/...            area, trail, drone and targets by latitude and longitude
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from dronemon.events import AreaLaid
from dronemon.frames import body_to_ned, ned_to_geo
from dronemon.palette import target_rgb
from dronemon.types import CameraModel, FloatArray, ImageArray, Pose
from dronemon.viz.entities import BLUE, CAMERA, GREY, RED, WHITE, path

_NED_TO_SCENE = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""East, north and up of north, east and down."""
_CAMERA_TO_BODY = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Forward, right and down of the picture's right, its bottom, and the way it looks."""
_ARM_SHARE = 0.012
"""Of the area's side, half the size of the drawn drone."""


class Scene:
    """Draws on the scene and the globe once the area is laid; not thread-safe."""

    def __init__(
        self, rec: rr.RecordingStream, laid: AreaLaid, camera: CameraModel, names: Sequence[str]
    ) -> None:
        self._rec, self._laid, self._names = rec, laid, names
        side_m = laid.area.side_m
        arm_m = _ARM_SHARE * side_m
        corners = self._ground_points(laid.area.arena.outline_au)
        rec.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        rec.log("scene/area", rr.LineStrips3D([corners], colors=GREY), static=True)
        zones = [self._ground_points(zone_au) for zone_au in laid.area.arena.zones_au]
        rec.log("scene/no_fly", rr.LineStrips3D(zones, colors=RED), static=True)
        box = rr.Boxes3D(half_sizes=[[arm_m, arm_m, 0.3 * arm_m]], colors=WHITE)
        rec.log("scene/vehicle/body", box, static=True)
        lens = rr.Pinhole(
            focal_length=camera.focal_px,
            width=camera.width_px,
            height=camera.height_px,
            image_plane_distance=0.1 * side_m,
        )
        rec.log(CAMERA, lens, rr.Transform3D(mat3x3=_CAMERA_TO_BODY), static=True)
        border = [self._ground_lat_lon(corner_au) for corner_au in laid.area.arena.outline_au]
        rec.log("world/area", rr.GeoLineStrings(lat_lon=[border], colors=BLUE), static=True)
        zones_lat_lon = [
            [self._ground_lat_lon(corner_au) for corner_au in zone_au]
            for zone_au in laid.area.arena.zones_au
        ]
        rec.log("world/no_fly", rr.GeoLineStrings(lat_lon=zones_lat_lon, colors=RED), static=True)

    def move(self, pose: Pose) -> list[float]:
        """Move and tilt the drone. -> its latitude and longitude"""
        position = _NED_TO_SCENE @ (np.array(pose.position_ned_m) - self._origin_ned_m())
        tilt = _NED_TO_SCENE @ body_to_ned(pose.attitude_rad)
        self._rec.log("scene/vehicle", rr.Transform3D(translation=position, mat3x3=tilt))
        place = self._lat_lon(pose.position_ned_m)
        self._rec.log("world/vehicle", rr.GeoPoints(lat_lon=[place], colors=WHITE, radii=-6.0))
        return place

    def draw_trail(self, places: Sequence[Sequence[float]]) -> None:
        """Draw the way flown lately on the globe. places: latitudes and longitudes"""
        self._rec.log("world/trail", rr.GeoLineStrings(lat_lon=[places], colors=GREY))

    def see(self, number: int, place_au: FloatArray) -> None:
        """Mark where a target was seen last."""
        name, rgb = self._names[number], target_rgb(number)
        point = self._ground_points(place_au[None])
        self._rec.log(
            path("scene", "seen", name), rr.Points3D(point, colors=rgb, radii=-5.0, labels=[name])
        )
        mark = rr.GeoPoints(lat_lon=[self._ground_lat_lon(place_au)], colors=rgb, radii=-5.0)
        self._rec.log(path("world", "seen", name), mark)

    def lay_belief(self, rgb: ImageArray) -> None:
        """Lay the picture of all beliefs on the ground. rgb: (G, G, 3), rows are y."""
        self._rec.log(
            "scene/ground",
            rr.Mesh3D(
                vertex_positions=self._ground_points(self._laid.area.arena.box_au),
                triangle_indices=[[0, 1, 2], [0, 2, 3]],
                vertex_texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]],
                albedo_texture=rgb,
            ),
        )

    def _origin_ned_m(self) -> FloatArray:
        """The scene's: the area's centre on the ground."""
        return np.array([*self._laid.area.centre_ned_m, self._laid.area.ground_down_m])

    def _ground_points(self, places_au: FloatArray) -> FloatArray:
        """(n, 2) au -> (n, 3) m east, north and up of the area's centre."""
        offset_m = self._laid.area.au_to_ned(places_au) - np.array(self._laid.area.centre_ned_m)
        return np.concatenate([offset_m[:, ::-1], np.zeros((len(offset_m), 1))], axis=-1)

    def _ground_lat_lon(self, place_au: FloatArray) -> list[float]:
        place = self._laid.area.au_to_geo(place_au, self._laid.origin)
        return [place.latitude_deg, place.longitude_deg]

    def _lat_lon(self, position_ned_m: Sequence[float]) -> list[float]:
        place = ned_to_geo(position_ned_m, self._laid.origin)
        return [place.latitude_deg, place.longitude_deg]
