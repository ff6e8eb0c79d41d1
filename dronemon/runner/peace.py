"""Targets left in peace: the path of a patrol keeps off where they are believed to be.

The planners know nothing of it: what they choose is flown to around such places, or as near as that
allows. It is for the patrol alone: whoever comes home or gives way to a pilot goes straight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dronemon.arena import detour, into
from dronemon.events import EventStream
from dronemon.frames import AreaFrame
from dronemon.guidance import Carrot
from dronemon.mission import Mission
from dronemon.planner.motion import ARRIVED_AU, way_length_au
from dronemon.problem import SENSOR_RADIUS_AU, WINDOW_AU
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Pose

_CONTACT_AU = 0.35
"""Sightings so long before the newest say how a target moves, ..."""
_BASE_AU = 0.05
"""... if they are so far apart; ..."""
_NUM_SIGHTS = 8
"""... of so many: pictures come by 0.1 au."""
_LOOK_S = 0.5
"""Vehicle time between two looks at the path, if no picture says anything new."""
_SHARE = 0.5
"""Of the clearance that the path may lose to targets that move before it is laid anew."""
_LEAST_AU = 0.02
"""A shorter way to the edge of a disc, for a goal inside, is none."""
_MOST_STAYS = 5
"""Ways that are none, one after the other, before the drone flies a stretch around the disc."""
_MOST_DISCS = 16
"""Nearest discs that a way is sought around, in the time of a setpoint; `keep` looks again."""
_TURNS_RAD = np.radians([60.0, -60.0, 120.0, -120.0, 180.0])


def believed_au(sightings: Sightings, number: int, time_au: float) -> FloatArray | None:
    """Where a target is believed to be: where it was seen last, and on as it moved then.

    -> (2,) au, None if it was never seen, or may have gone anywhere since: as far as the sensor
    sees, or for as long as a measurement counts
    """
    sights = sightings.sights(number, math.inf, _NUM_SIGHTS)
    if not sights:
        return None
    newest, since_au = sights[-1], max(time_au - sights[-1].time_au, 0.0)
    steps_au = sum(math.dist(a[1:], b[1:]) for a, b in pairwise(sights))
    speed = steps_au / max(newest.time_au - sights[0].time_au, _BASE_AU)
    if since_au > WINDOW_AU or speed * since_au > SENSOR_RADIUS_AU:
        return None
    first = next(sight for sight in sights if sight.time_au >= newest.time_au - _CONTACT_AU)
    lasted_au, place_au = newest.time_au - first.time_au, np.array(newest[1:])
    if lasted_au >= _BASE_AU:
        place_au += (place_au - first[1:]) * (since_au / lasted_au)
    return place_au


class Peace:
    """Lays the path of a patrol, and lays it anew where a target comes near it."""

    def __init__(
        self, mission: Mission, frame: AreaFrame, sightings: Sightings, events: EventStream
    ) -> None:
        self._targets, self._clearance_m = mission.targets, mission.flight.clearance_m
        self._kept_off_m = mission.kept_off_m
        self._frame, self._sightings, self._events = frame, sightings, events
        self._num_known, self._due_s = 0, -math.inf
        self._num_stays = 0
        self._are_inside: set[int] = set()  # whose discs the path was laid out of
        self._are_told: set[int] = set()

    def lengthen(self, carrot: Carrot, goal_au: FloatArray, time_au: float) -> FloatArray:
        """Have the path lead on to a goal (2,) au, or as near as it may. -> where it ends, (2,).

        Where it has no way to fly for it, -> the goal, as if it were there: a planner that goes
        round and round would else wait for ever to reach a place that it must not.
        """
        way_au = goal_au[None]
        if self._kept_off_m:
            places_au = self._believed_au(time_au)
            way_au = self._way(self._au(carrot.end_m), goal_au, places_au)
        for place_au in way_au:
            north_m, east_m = self._frame.au_to_ned(place_au).tolist()
            carrot.extend((north_m, east_m))
        return way_au[-1] if len(way_au) else goal_au

    def keep(
        self, carrot: Carrot, pose: Pose, waypoint_au: FloatArray, time_au: float
    ) -> FloatArray:
        """Turn off a path to a waypoint that leads too near to a target. -> as `lengthen`."""
        if not self._is_due(pose.time_s):
            return waypoint_au
        path_au = np.stack([self._au(place_m) for place_m in carrot.ahead_m])
        if not self._frame.arena.segment_is_free(path_au[0], path_au[0]):
            return waypoint_au  # on its way from a home outside of the field
        places_au = self._believed_au(time_au)
        self._tell(places_au, self._au(pose.position_ned_m[:2]))
        discs_au = self._discs_au(places_au, _SHARE)
        is_in = into(path_au[:1], discs_au)
        inside = {number for number, here in zip(places_au, is_in, strict=True) if here}
        is_new = not inside <= self._are_inside
        self._are_inside = inside
        if not (is_new or _enters(path_au, discs_au)):
            return waypoint_au
        carrot.turn_off()
        return self.lengthen(carrot, path_au[-1], time_au)

    def _is_due(self, now_s: float) -> bool:
        """Whether the path is to be looked at."""
        if not self._kept_off_m:
            return False
        if len(self._sightings) != self._num_known:
            self._num_known = len(self._sightings)
            self._are_inside.clear()
        elif now_s < self._due_s:
            return False
        self._due_s = now_s + _LOOK_S
        return True

    def _au(self, place_m: Sequence[float]) -> FloatArray:
        return self._frame.ned_to_au(np.array(place_m))

    def _believed_au(self, time_au: float) -> dict[int, FloatArray]:
        """Places of all targets that are kept off and of which it is known, by their numbers."""
        believed = {n: believed_au(self._sightings, n, time_au) for n in self._kept_off_m}
        arena = self._frame.arena
        return {n: arena.clip(place_au) for n, place_au in believed.items() if place_au is not None}

    def _discs_au(self, places_au: dict[int, FloatArray], share: float) -> FloatArray:
        """Around these places, wider than asked for by a share of the clearance. -> (D, 3) au."""
        side_m, margin_m = self._frame.side_m, share * self._clearance_m
        rows = [(*xy, (self._kept_off_m[n] + margin_m) / side_m) for n, xy in places_au.items()]
        return np.array(rows).reshape(-1, 3)

    def _way(
        self, start_au: FloatArray, goal_au: FloatArray, places_au: dict[int, FloatArray]
    ) -> FloatArray:
        """Around the targets to the goal, or around one where it asks to stay. -> (K, 2) au."""
        discs_au = _nearest(self._discs_au(places_au, 1.0), start_au)
        way_au = detour(self._frame.arena, start_au, goal_au, discs_au)
        is_there = bool(len(way_au)) and math.dist(way_au[-1], goal_au) <= ARRIVED_AU
        is_too_near = into(start_au[None], self._discs_au(places_au, _SHARE)).any()
        if is_there or is_too_near or way_length_au(start_au, way_au) >= _LEAST_AU:
            self._num_stays = 0
            return way_au
        self._num_stays += 1
        return self._around(start_au, discs_au) if self._num_stays >= _MOST_STAYS else way_au[:0]

    def _around(self, start_au: FloatArray, discs_au: FloatArray) -> FloatArray:
        """A stretch around the nearest disc; none where there is no room. -> (K, 2) au."""
        *centre_au, radius_au = discs_au[0]
        x_au, y_au = start_au - centre_au
        for turn_rad in _TURNS_RAD + math.atan2(y_au, x_au):
            off_au = radius_au * np.array([math.cos(turn_rad), math.sin(turn_rad)])
            way_au = detour(self._frame.arena, start_au, centre_au + off_au, discs_au)
            if way_length_au(start_au, way_au) >= _LEAST_AU:
                self._num_stays = 0
                return way_au
        return np.empty((0, 2))

    def _tell(self, places_au: dict[int, FloatArray], here_au: FloatArray) -> None:
        """Say who is nearer than asked for, once until it is not any more."""
        self._are_told &= places_au.keys()
        for number, place_au in places_au.items():
            away_m = math.dist(place_au, here_au) * self._frame.side_m
            least_m, name = self._kept_off_m[number], self._targets[number].name
            if away_m < least_m and number not in self._are_told:
                self._are_told.add(number)
                what = f"{name} is {away_m:.0f} m away, nearer than {least_m:g} m: it turns off"
                self._events.note("keeps off", what, target=name, away_m=away_m)
            elif away_m > least_m + _SHARE * self._clearance_m:
                self._are_told.discard(number)


def _nearest(discs_au: FloatArray, place_au: FloatArray) -> FloatArray:
    """The discs whose edges are nearest to a place, nearest first. (D, 3) -> (K, 3)."""
    away_au = np.linalg.norm(discs_au[:, :2] - place_au, axis=-1) - discs_au[:, 2]
    return discs_au[np.argsort(away_au)[:_MOST_DISCS]]


def _enters(path_au: FloatArray, discs_au: FloatArray) -> bool:
    """Whether a path leads into any disc, or not out of one that it begins in."""
    for disc_au in discs_au:
        away_au = np.linalg.norm(path_au - disc_au[:2], axis=-1)
        outside = np.flatnonzero(away_au >= disc_au[2])
        if not len(outside) or into(path_au[outside[0] :], disc_au[None]).any():
            return True
    return False
