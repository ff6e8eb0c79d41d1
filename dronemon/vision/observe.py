"""What the binary sensor says about every target, given what was found in one picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dronemon.frames import AreaFrame
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.sightings import Sightings
from dronemon.types import CameraModel, Detection, FloatArray, Measurement, Pose
from dronemon.vision.owners import NOBODY, Owners
from dronemon.vision.project import shown_radius_m
from dronemon.vision.surface import Surface, down_below_m


def observe(
    detections: Sequence[Detection],
    *,
    pose: Pose,
    camera: CameraModel,
    frame: AreaFrame,
    surface: Surface,
    owners: Owners,
    sightings: Sightings,
    time_au: float,
) -> tuple[Measurement, list[int]]:
    """One observation of every target, and which of them each find is, or `NOBODY`.

    A target is seen if it was found less than SENSOR_RADIUS_AU from the vehicle, over ground; what
    the picture shows beyond does not count. Where a tilt turns some of that out of the picture, it
    counts as looked at only as far as the picture shows it to all sides, and where things stand
    only as far as none of them hides it.
    sightings: what was seen before
    Source: paper, equation 1.
    """
    agent_au = frame.ned_to_au(np.array(pose.position_ned_m))
    pixels_px = np.array([d.pixel_px for d in detections]).reshape(-1, 2)
    places_au = frame.ned_to_au(surface.places(pixels_px, camera, pose))
    away_au = np.linalg.norm(places_au - agent_au, axis=-1)
    near = np.flatnonzero(away_au < SENSOR_RADIUS_AU).tolist()
    own = owners.of(
        [detections[d].appearance for d in near],
        [detections[d].score for d in near],
        places_au[near],
        agent_au=agent_au,
        time_au=time_au,
        sightings=sightings,
    )
    seen = np.zeros(owners.num_targets, np.bool_)
    target_au = np.full((owners.num_targets, 2), np.nan)
    whose = [NOBODY] * len(detections)
    for find, target in zip(near, own, strict=True):
        if target != NOBODY:
            whose[find], seen[target], target_au[target] = target, True, places_au[find]
    shown_au = shown_radius_m(camera, pose, down_below_m(surface, pose)) / frame.side_m
    view_au = min(shown_au, SENSOR_RADIUS_AU)
    hidden_au = surface.hidden_au(pose)
    if hidden_au is not None:
        hidden_au = _cut(hidden_au, view_au)
        view_au = float(hidden_au[:, 0].min())
    measurement = Measurement(
        time_au=time_au,
        agent_au=agent_au,
        seen=seen,
        target_au=target_au,
        view_au=view_au,
        hidden_au=hidden_au,
    )
    return measurement, whose


def _cut(hidden_au: FloatArray, view_au: float) -> FloatArray:
    """The same of a picture that shows ground no farther than that: beyond, none is in view."""
    if view_au >= SENSOR_RADIUS_AU:
        return hidden_au
    first_au = np.minimum(hidden_au[:, 0], view_au)
    return np.stack([first_au, np.full_like(first_au, SENSOR_RADIUS_AU)], axis=-1)
