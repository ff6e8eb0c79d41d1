"""Whether targets are within the error told of their place: `python benchmarks/ground_error.py`.

A target on the ground is seen by a vehicle that is not quite where, nor tilted quite as, it says,
through a lens that is not quite the mission's, at another instant than is thought, by a detector
that is off: each by a draw of its stated distribution. Its place is told as in flight, from what is
believed; the share of truths in the 95 % ellipse about it is to be 92 to 98 % in every setting.

With `--pictures P` the same with drawn animals in rendered pictures and the real detector, whose
own error is whatever it is; told is the root of its mean square along an axis of the picture.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from vision import CAMERA, is_whole

from dronemon.frames import ground_to_pixel, pixel_to_ground
from dronemon.mission.camera import PlaceErrors
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import APPEARANCES, CameraModel, FloatArray, Pose, Vector3
from dronemon.vision.drawn import DrawnDetector
from dronemon.vision.ground_error import ground_covariance, told_covariance
from dronemon.vision.surface import Plane
from sim.random_scene import SIDE_M, random_scene
from sim.renderer import Renderer

ERRORS = PlaceErrors()
ELLIPSE_95 = -2.0 * math.log(0.05)
RADIUS_M = SENSOR_RADIUS_AU * SIDE_M


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """How the drone flies, and how far from the point below it the target is."""

    height_m: float = 45.0
    tilt_deg: float = 0.0
    away_m: float = 0.5 * RADIUS_M
    speed_m_s: float = 5.0
    turn_deg_s: float = 0.0
    time_s: float = ERRORS.time_s


SETTINGS = {
    "level, 45 m up, target 10 m aside, 5 m/s": Setting(),
    "tilted 10 degrees": Setting(tilt_deg=10.0),
    "tilted 20 degrees": Setting(tilt_deg=20.0),
    "20 m up": Setting(height_m=20.0),
    "100 m up": Setting(height_m=100.0),
    "target right below": Setting(away_m=0.0),
    "target at the footprint's edge": Setting(away_m=RADIUS_M),
    "edge, tilted 10 degrees": Setting(away_m=RADIUS_M, tilt_deg=10.0),
    "edge, tilted 20 degrees": Setting(away_m=RADIUS_M, tilt_deg=20.0),
    "edge, tilted 20 degrees, 25 m up": Setting(away_m=RADIUS_M, tilt_deg=20.0, height_m=25.0),
    "hovering": Setting(speed_m_s=0.0),
    "15 m/s": Setting(speed_m_s=15.0),
    "15 m/s, times off by 0.1 s": Setting(speed_m_s=15.0, time_s=0.1),
    "edge, tilted 20 degrees, turning at 30 degrees/s, times off by 0.1 s": Setting(
        away_m=RADIUS_M, tilt_deg=20.0, speed_m_s=15.0, turn_deg_s=30.0, time_s=0.1
    ),
}


def believed(
    true: Pose, turn_rad_s: Vector3, errors: PlaceErrors, rng: np.random.Generator
) -> Pose:
    """What the vehicle says of itself at the time that a picture is thought to be of."""
    late_s = rng.normal(0.0, errors.time_s)
    off_m = rng.normal(0.0, [errors.position_m, errors.position_m, errors.height_m])
    off_deg = rng.normal(0.0, [errors.tilt_deg, errors.tilt_deg, errors.heading_deg])
    place = np.array(true.position_ned_m) + late_s * np.array(true.velocity_ned_m_s) + off_m
    attitude = np.array(true.attitude_rad) + late_s * np.array(turn_rad_s) + np.radians(off_deg)
    return replace(
        true,
        position_ned_m=tuple(place.tolist()),
        attitude_rad=tuple(attitude.tolist()),
    )


def is_inside(true_m: FloatArray, told_m: FloatArray, covariance_m2: FloatArray) -> bool:
    """Whether a truth is in the 95 % ellipse about a place told."""
    off_m = told_m - true_m
    return bool(off_m @ np.linalg.solve(covariance_m2, off_m) <= ELLIPSE_95)


def covers(setting: Setting, rng: np.random.Generator) -> bool:
    """Draw one sighting; whether its target is in the ellipse told."""
    errors = ERRORS.model_copy(update={"time_s": setting.time_s})
    towards, heading, leaning, bearing = rng.uniform(-math.pi, math.pi, 4)
    tilt_rad, turn_rad_s = math.radians(setting.tilt_deg), math.radians(setting.turn_deg_s)
    turns = (turn_rad_s * math.sin(leaning), turn_rad_s * math.cos(leaning), turn_rad_s)
    speed = setting.speed_m_s
    true = Pose(
        time_s=0.0,
        position_ned_m=(0.0, 0.0, -setting.height_m),
        velocity_ned_m_s=(speed * math.cos(towards), speed * math.sin(towards), 0.0),
        attitude_rad=(tilt_rad * math.sin(leaning), tilt_rad * math.cos(leaning), heading),
    )
    target_m = setting.away_m * np.array([math.cos(bearing), math.sin(bearing)])
    focal_px = CAMERA.focal_px * (1.0 + rng.normal(0.0, errors.focal_share))
    fov_rad = 2.0 * math.atan(CAMERA.width_px / 2.0 / focal_px)
    lens = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=fov_rad)
    pixel_px = ground_to_pixel(target_m, lens, true, rng.normal(0.0, errors.ground_m))
    pixel_px = pixel_px + rng.normal(0.0, errors.pixel_px, 2)
    pose = believed(true, turns, errors, rng)
    told = told_covariance(errors, pose, turns, None, None)
    place_m = pixel_to_ground(pixel_px, CAMERA, pose, 0.0)
    return is_inside(target_m, place_m, ground_covariance(pixel_px, CAMERA, pose, Plane(0.0), told))


def drawn_animals(rng: np.random.Generator, num: int, seed: int) -> Iterator[tuple[float, bool]]:
    """Of each animal found in rendered pictures: squared error in px^2, and whether it is covered.

    The detector is told the pose that is believed, as in flight.
    """
    renderer = Renderer(CAMERA, seed)
    detector = DrawnDetector(APPEARANCES, CAMERA, min_score=0.5)
    errors, still = ERRORS.model_copy(update={"ground_m": 0.0, "focal_share": 0.0}), (0.0,) * 3
    for _ in range(num):
        scene = random_scene(rng)
        image, down_m = renderer.render(scene), scene.frame.ground_down_m
        animals = {a.appearance: a for a in scene.animals if is_whole(scene, a)}
        pose = believed(scene.pose, still, errors, rng)
        told = told_covariance(errors, pose, still, None, None)
        for find in detector.detect(image, pose, down_m):
            if find.appearance not in animals:
                continue
            true_m = np.array(animals[find.appearance].position_ned_m)
            pixel_px = np.array(find.pixel_px)
            off_px = pixel_px - ground_to_pixel(true_m, CAMERA, scene.pose, down_m)
            place_m = pixel_to_ground(pixel_px, CAMERA, pose, down_m)
            covariance_m2 = ground_covariance(pixel_px, CAMERA, pose, Plane(down_m), told)
            yield float((off_px**2).mean()), is_inside(true_m, place_m, covariance_m2)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sightings", type=int, default=4000, help="in each setting")
    parser.add_argument("--pictures", type=int, default=0, help="rendered, for the real detector")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    print("setting                                                    in the 95 % ellipse")
    for name, setting in SETTINGS.items():
        share = np.mean([covers(setting, rng) for _ in range(options.sightings)])
        print(f"{name:70s} {share:7.1%}")
    if options.pictures:
        cv2.setNumThreads(1)
        found = list(drawn_animals(rng, options.pictures, options.seed))
        squared_px2, inside = zip(*found, strict=True)
        rms_px, share = math.sqrt(np.mean(squared_px2)), np.mean(inside)
        print(f"{len(found)} drawn animals, detector off by {rms_px:.2f} px {share:16.1%}")


if __name__ == "__main__":
    main()
