"""How old a picture is when it arrives, from a vehicle that turns: pictures turn with it, later."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from dronemon.errors import CameraError
from dronemon.types import FloatArray, ImageArray

MAX_LATENCY_S = 2.0
_STEP_S = 0.005
_FEATURES, _LEAST_FEATURES = 300, 12
_TRACKED_PX = 640
"""Width of the pictures that are compared."""
_LEAST_PAIRS = 30
_LEAST_TURN_RAD = math.radians(0.5)
"""From picture to picture, in the mean square; less is lost in noise."""
_LEAST_AGREEMENT = 0.9
"""Correlation of what pictures and vehicle say."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency:
    """How old pictures are.

    error_s:   standard error
    agreement: correlation of the turns of pictures and vehicle
    num_pairs: pictures that were compared with the one before
    """

    latency_s: float
    error_s: float
    agreement: float
    num_pairs: int


def turn_between(before: ImageArray, after: ImageArray) -> float | None:
    """Clockwise turn in rad of a camera that looks down, from one picture to the next.

    -> None where the pictures have too little in common
    """
    scale = min(1.0, _TRACKED_PX / before.shape[1])
    first, second = (
        cv2.resize(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), None, fx=scale, fy=scale)
        for image in (before, after)
    )
    points = cv2.goodFeaturesToTrack(first, _FEATURES, 0.01, 8.0)
    if points is None or len(points) < _LEAST_FEATURES:
        return None
    there, is_found, _ = cv2.calcOpticalFlowPyrLK(first, second, points, np.empty_like(points))
    kept = is_found.ravel() == 1
    if kept.sum() < _LEAST_FEATURES:
        return None
    matrix, inliers = cv2.estimateAffinePartial2D(points[kept], there[kept])
    if matrix is None or inliers.sum() < max(_LEAST_FEATURES, kept.sum() // 2):
        return None
    # The ground turns the other way; v runs down, so that its angle is clockwise.
    return -math.atan2(matrix[1, 0], matrix[0, 0])


def latency_of(
    arrived_s: FloatArray, turns_rad: FloatArray, pose_times_s: FloatArray, yaws_rad: FloatArray
) -> Latency:
    """The latency with which the pictures' turns fit the vehicle's best.

    arrived_s:    (P, 2) s vehicle time at which the two pictures of each pair came
    turns_rad:    (P,) rad clockwise turn from the one to the other
    pose_times_s: (M,) s vehicle time of the poses, from 2 s before the first picture on
    yaws_rad:     (M,) rad

    Raises CameraError where they say too little, or do not fit.
    """
    told = arrived_s[:, 0] >= pose_times_s[0] + MAX_LATENCY_S
    arrived_s, turns_rad = arrived_s[told], turns_rad[told]
    if len(turns_rad) < _LEAST_PAIRS:
        raise CameraError(
            f"{len(turns_rad)} pictures could be compared with the one before, and {_LEAST_PAIRS} "
            "are needed; show the camera ground with some texture, sharp, for longer"
        )
    lags_s = np.arange(0.0, MAX_LATENCY_S + _STEP_S, _STEP_S)
    yaws_at = np.interp(
        arrived_s[:, :, None] - lags_s, pose_times_s, np.unwrap(yaws_rad)
    )  # (P, 2, L)
    by_vehicle_rad = yaws_at[:, 1] - yaws_at[:, 0]  # (P, L)
    errors = np.square(turns_rad[:, None] - by_vehicle_rad).sum(axis=0)
    best = int(errors.argmin())
    if best == len(lags_s) - 1:
        raise CameraError(f"the pictures are older than {MAX_LATENCY_S:g} s, too old to fly with")
    agreement = _agreement(turns_rad, by_vehicle_rad, best)
    num_pairs = len(turns_rad)
    return Latency(**_refined(errors, best, num_pairs), agreement=agreement, num_pairs=num_pairs)


def _agreement(turns_rad: FloatArray, by_vehicle_rad: FloatArray, best: int) -> float:
    """Correlation at the best lag of (P,) turns with the vehicle's (P, L). Raises CameraError."""
    turned_rad = math.sqrt(np.square(by_vehicle_rad[:, best]).mean())
    if turned_rad < _LEAST_TURN_RAD:
        raise CameraError(
            f"the vehicle turned by {math.degrees(turned_rad):.2f} degrees from picture to picture,"
            f" and {math.degrees(_LEAST_TURN_RAD):g} are needed; turn it faster, to and fro"
        )
    agreements = np.corrcoef(turns_rad, by_vehicle_rad, rowvar=False)[0, 1:]
    agreement = float(agreements[best])
    if not agreement >= _LEAST_AGREEMENT:
        why = (
            "the pictures turn the other way: are they mirrored, or does the camera look up?"
            if agreements.min() <= -_LEAST_AGREEMENT
            else "turn it to and fro, unevenly and level, over ground that does not move"
        )
        raise CameraError(
            f"the turns of pictures and vehicle agree by {agreement:.2f}, "
            f"and {_LEAST_AGREEMENT:g} is needed; {why}"
        )
    return agreement


def _refined(errors: FloatArray, best: int, num_pairs: int) -> dict[str, float]:
    """The bottom of the parabola through the least error and its neighbours, and how flat it is."""
    middle = max(best, 1)
    left, least, right = errors[middle - 1 : middle + 2]
    curvature = (left - 2.0 * least + right) / _STEP_S**2
    if not curvature > 0.0:
        raise CameraError("no delay fits better than others; turn it faster, to and fro, unevenly")
    bottom_s = _STEP_S * middle - (right - left) / (2.0 * _STEP_S) / curvature
    variance = errors[best] / (num_pairs - 1)
    return {
        "latency_s": max(0.0, float(bottom_s)),
        "error_s": math.sqrt(2.0 * variance / curvature),
    }
