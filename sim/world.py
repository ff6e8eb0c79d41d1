"""The simulated world of a mission: the area, and animals that walk in it.

The animals rest until the first picture is taken in the air, so that positions known before
take-off hold when the patrol begins; from then on each walks its path at constant speed.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np

from dronemon.errors import OptionError
from dronemon.frames import AreaFrame, GeoPoint, geo_to_ned
from dronemon.mission import (
    Mission,
    field_centre,
    lay_frame,
    mission_arena,
    mission_obstacles,
)
from dronemon.mission.schema import Target
from dronemon.types import FloatArray, Obstacle, Pose, Vector3
from dronemon.vision.heights import read_heights
from dronemon.vision.terrain import Terrain
from dronemon.world import Instance
from sim.robots import look_of
from sim.scene import Animal, Scene

DEFAULT_PLACE = GeoPoint(latitude_deg=47.397742, longitude_deg=8.545594, altitude_m=488.0)
"""Home of a mission without coordinates."""
AIRBORNE_M = 2.0
"""Height from which a picture is one of the flight."""


def _look(mission: Mission, target: Target) -> str:
    """What a target is drawn as."""
    of = mission.detector
    if of.kind != "markers" or not mission.camera.is_simulated:
        return target.appearance
    if of.side_m is None:
        raise OptionError("detector.side_m is missing: how large are the markers to be drawn?")
    return look_of(of.family, target.appearance, of.side_m)


class World:
    """Where the targets of a mission are at any time since the first picture in the air.

    looks: what each target is drawn as, where pictures are drawn at all
    """

    def __init__(self, mission: Mission, walked_s: float = 0.0) -> None:
        self._mission = mission
        self._walking_s = walked_s
        self._pictured_s: float | None = None
        self._terrain: Terrain | None = None
        self._obstacles = mission_obstacles(mission)
        self.looks = [_look(mission, target) for target in mission.targets]
        simulated = mission.simulation
        self._paths = Instance.draw(
            simulated.seed,
            len(mission.targets),
            simulated.motion,
            simulated.speed_spread,
            mission_arena(mission),
        ).paths

    def walked_au(self, walking_s: float) -> float:
        """Distance that every target has walked."""
        simulation, area = self._mission.simulation, self._mission.area
        speed_m_s = simulation.speed_ratio * self._mission.flight.cruise_speed_m_s
        return speed_m_s * max(walking_s, 0.0) / area.side_m

    def targets_au(self, walking_s: float) -> FloatArray:
        """(N, 2) au positions of the targets."""
        return self._paths.positions_au(self.walked_au(walking_s))

    def frame(self, home_ned_m: Vector3, origin: GeoPoint) -> AreaFrame:
        """The area, laid around home or the mission's coordinates, and its ground with it."""
        north, east = home_ned_m[0], home_ned_m[1]
        if (path := self._mission.area.terrain) is not None:
            heights, (*home_m, down_m) = read_heights(path), home_ned_m
            self._terrain = Terrain(heights, origin, np.array(home_m), down_m)
        if (centre := _area_centre(self._mission, origin.altitude_m)) is not None:
            north, east, _ = (float(v) for v in geo_to_ned(centre, origin))
        return lay_frame(self._mission, (north, east), home_ned_m[2])

    def ground_down_m(self, places_ned_m: FloatArray, frame: AreaFrame) -> FloatArray:
        """Down coordinate of the ground; the take-off's where its height is not known.

        places_ned_m: (..., 2) north, east -> (...)
        """
        flat_m = np.full(places_ned_m.shape[:-1], frame.ground_down_m)
        if self._terrain is None:
            return flat_m
        downs_m = self._terrain.down_m(places_ned_m)
        return np.where(np.isnan(downs_m), flat_m, downs_m)

    def scene(
        self,
        pose: Pose,
        frame: AreaFrame,
        now_s: float,
        turn_rad_s: Vector3 = (0.0, 0.0, 0.0),
    ) -> Scene:
        """What a camera at `pose` takes a picture of; time that goes back does not count."""
        if self._pictured_s is not None:
            self._walking_s += max(now_s - self._pictured_s, 0.0)
        if frame.height_m(pose.position_ned_m[2]) > AIRBORNE_M or self._pictured_s is not None:
            self._pictured_s = now_s
        walked_au = self.walked_au(self._walking_s)
        places = frame.au_to_ned(self._paths.positions_au(walked_au))
        headings = self._paths.headings_rad(walked_au)
        below_m = float(self.ground_down_m(np.array(pose.position_ned_m[:2]), frame))
        ups_m = (below_m - self.ground_down_m(places, frame)).tolist()
        animals = tuple(
            Animal(
                name=target.name,
                appearance=look,
                position_ned_m=(float(place[0]), float(place[1])),
                heading_rad=math.pi / 2.0 + frame.heading_rad - float(heading),
                walked_m=walked_au * frame.side_m,
                up_m=up_m,
            )
            for target, look, place, heading, up_m in zip(
                self._mission.targets, self.looks, places, headings, ups_m, strict=True
            )
        )
        return Scene(
            pose=pose,
            frame=replace(frame, ground_down_m=below_m),
            animals=animals,
            obstacles=tuple(
                (obstacle, below_m - self._foot_down_m(obstacle, frame))
                for obstacle in self._obstacles
            ),
            turn_rad_s=turn_rad_s,
        )

    def _foot_down_m(self, obstacle: Obstacle, frame: AreaFrame) -> float:
        """Down coordinate of the highest ground below something."""
        return float(self.ground_down_m(frame.au_to_ned(obstacle.corners_au), frame).min())


def home_place(mission: Mission) -> GeoPoint:
    """Where the mock stands at first: the area's centre, if the mission says where that is.

    If the drone may not be there, the nearest place where it may.
    """
    centre = _area_centre(mission, DEFAULT_PLACE.altitude_m)
    if centre is None:
        return DEFAULT_PLACE
    frame = lay_frame(mission, (0.0, 0.0), 0.0)
    middle_au = np.array([0.5, 0.5])
    if frame.arena.segment_is_free(middle_au, middle_au):
        return centre
    return frame.au_to_geo(frame.arena.clip_free(middle_au), centre)


def _area_centre(mission: Mission, altitude_m: float) -> GeoPoint | None:
    centre = field_centre(mission.area)
    return replace(centre, altitude_m=altitude_m) if centre is not None else None


class TruthFile:
    """A line of JSON for each picture, after those that are there: where everything really was.

    Without a path it writes nothing.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path

    def __enter__(self) -> Self:
        self._file = (self.path or Path(os.devnull)).open("a", encoding="utf-8")
        return self

    def __exit__(self, *exc: object) -> None:
        self._file.close()

    def write(self, scene: Scene) -> None:
        """Append one scene."""
        frame, pose = scene.frame, scene.pose
        line = {
            "time_s": pose.time_s,
            "agent_au": frame.ned_to_au(np.array(pose.position_ned_m)).tolist(),
            "targets_au": [
                frame.ned_to_au(np.array(a.position_ned_m)).tolist() for a in scene.animals
            ],
            "position_ned_m": pose.position_ned_m,
            "velocity_ned_m_s": pose.velocity_ned_m_s,
            "attitude_rad": pose.attitude_rad,
        }
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()
