"""How well the detector finds simulated animals: `python benchmarks/vision.py [--seed S]`.

Each picture has a random place, heading, height (35 m +-20 %) and tilt (up to 15 degrees) over a
random area of 200 m with one animal of every appearance, at least one of them near the vehicle, and
goes through the JPEG of the stream. With `--height-m H` the height is H and the area H/35 as large.
An animal counts for recall if it is drawn wholly inside both the sensor's circle and the picture.
`dronemon.vision.prototypes` was measured on other seeds (`--measure`, 10001 and up).
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np

from dronemon.frames import AreaFrame, ground_to_pixel, pixel_to_ground
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import (
    ANIMALS,
    PEOPLE,
    VEHICLES,
    CameraModel,
    Detection,
    FloatArray,
    ImageArray,
    Pose,
)
from dronemon.vision.drawn import DrawnDetector
from dronemon.vision.prototypes import COAT_COLOURS, PROTOTYPES
from sim.camera import encode
from sim.renderer import Renderer
from sim.scene import Animal, Scene
from sim.sprites import drawn_size_m

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
SIDE_M = 200.0
HEIGHT_M = 35.0
MAX_TILT_RAD = math.radians(15.0)
MATCH_M = 2.5
"""A detection this near to an animal is of that animal."""


def random_scene(
    rng: np.random.Generator,
    height_m: float | None = None,
    *,
    appearances: tuple[str, ...] = ANIMALS,
    reach: float = 1.0,
    num_near: int = 1,
) -> Scene:
    """A scene with `num_near` animals within `reach` sensor radii and the others anywhere."""
    side_m = SIDE_M if height_m is None else SIDE_M * height_m / HEIGHT_M
    frame = AreaFrame(
        centre_ned_m=(rng.uniform(-300.0, 300.0), rng.uniform(-300.0, 300.0)),
        ground_down_m=rng.uniform(-5.0, 5.0),
        side_m=side_m,
        heading_rad=rng.uniform(-math.pi, math.pi),
        cruise_speed_m_s=5.0,
    )
    north_m, east_m = frame.au_to_ned(rng.uniform(0.0, 1.0, 2))
    tilt_rad, towards = MAX_TILT_RAD * math.sqrt(rng.uniform()), rng.uniform(-math.pi, math.pi)
    if height_m is None:
        height_m = HEIGHT_M * rng.uniform(0.8, 1.2)
    pose = Pose(
        time_s=rng.uniform(0.0, 1000.0),
        position_ned_m=(north_m, east_m, frame.ground_down_m - height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=(
            tilt_rad * math.sin(towards),
            tilt_rad * math.cos(towards),
            rng.uniform(-math.pi, math.pi),
        ),
    )
    near = rng.permutation(len(appearances))[:num_near]
    animals: list[Animal] = []
    for i, appearance in enumerate(appearances):
        at_m = frame.au_to_ned(rng.uniform(0.0, 1.0, 2))
        if i in near:
            reach_m, bearing = reach * SENSOR_RADIUS_AU * side_m, rng.uniform(0.0, math.tau)
            at_m = np.array([north_m, east_m]) + reach_m * math.sqrt(rng.uniform()) * np.array(
                [math.cos(bearing), math.sin(bearing)]
            )
        animal = Animal(
            name=appearance,
            appearance=appearance,
            position_ned_m=(at_m[0], at_m[1]),
            heading_rad=rng.uniform(-math.pi, math.pi),
            walked_m=rng.uniform(0.0, 100.0),
        )
        if not any(touch(animal, other) for other in animals):
            animals.append(animal)
    return Scene(pose=pose, frame=frame, animals=tuple(animals))


def touch(one: Animal, other: Animal) -> bool:
    """Whether two may be drawn one over the other."""
    lengths_m = [drawn_size_m(animal.appearance)[0] for animal in (one, other)]
    return math.dist(one.position_ned_m, other.position_ned_m) < 0.5 * sum(lengths_m)


def is_whole(scene: Scene, animal: Animal) -> bool:
    """Whether an animal is drawn wholly inside the sensor's circle and the picture."""
    length_m, width_m, height_m = drawn_size_m(animal.appearance)
    s, c = math.sin(animal.heading_rad), math.cos(animal.heading_rad)
    box_m = 0.5 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * (length_m, width_m)
    corners_m = np.array(animal.position_ned_m) + box_m @ np.array([[c, s], [-s, c]])
    distance_m = np.linalg.norm(corners_m - scene.pose.position_ned_m[:2], axis=1)
    pixels = np.concatenate(
        [
            ground_to_pixel(corners_m, CAMERA, scene.pose, scene.frame.ground_down_m - up_m)
            for up_m in (0.0, height_m)
        ]
    )
    in_picture = (pixels > 0.0) & (pixels < (CAMERA.width_px, CAMERA.height_px))
    radius_m = SENSOR_RADIUS_AU * scene.frame.side_m
    return bool(distance_m.max() <= radius_m and in_picture.all())


@dataclass
class Tally:
    """Counts over all pictures."""

    num_pictures: int = 0
    num_whole: int = 0
    num_found: int = 0
    num_wrong: int = 0
    num_detections: int = 0
    num_false_pictures: int = 0
    errors_m: list[float] = field(default_factory=list)

    def add(self, scene: Scene, detections: tuple[Detection, ...]) -> None:
        """Compare what was found in one picture with what is there."""
        positions_m = np.array([a.position_ned_m for a in scene.animals])
        named = set()
        is_false = False
        for detection in detections:
            at_m = _ground(detection.pixel_px, scene)
            distance_m = np.linalg.norm(positions_m - at_m, axis=1)
            nearest = int(distance_m.argmin())
            if distance_m[nearest] >= MATCH_M:
                is_false = True
            elif scene.animals[nearest].appearance != detection.appearance:
                self.num_wrong += 1
            else:
                named.add(nearest)
                if is_whole(scene, scene.animals[nearest]):
                    self.errors_m.append(float(distance_m[nearest]))
        whole = {i for i, animal in enumerate(scene.animals) if is_whole(scene, animal)}
        self.num_pictures += 1
        self.num_detections += len(detections)
        self.num_whole += len(whole)
        self.num_found += len(whole & named)
        self.num_false_pictures += is_false

    def lines(self) -> Iterator[str]:
        """The table, with the limit of each figure."""
        median_m, p95_m = np.percentile(self.errors_m, [50.0, 95.0])
        recall = self.num_found / self.num_whole
        wrong = self.num_wrong / max(self.num_detections, 1)
        false = self.num_false_pictures / self.num_pictures
        yield f"recall                     {recall:8.2%}   (>= 98 %)   {self.num_whole} animals"
        yield f"wrong appearance           {wrong:8.2%}   (<= 0.5 %)  {self.num_detections} found"
        yield f"pictures with a false find {false:8.2%}   (<= 0.5 %)  {self.num_pictures} pictures"
        yield f"ground error, median       {median_m:6.2f} m   (<= 0.5 m)"
        yield f"ground error, 95 %         {p95_m:6.2f} m   (<= 1.5 m)"


def _ground(pixel_px: tuple[float, float], scene: Scene) -> FloatArray:
    return pixel_to_ground(np.array(pixel_px), CAMERA, scene.pose, scene.frame.ground_down_m)


def benchmark(
    seed: int, num_pictures: int, appearances: tuple[str, ...], height_m: float | None
) -> None:
    """Print how well and how fast targets are found."""
    rng = np.random.default_rng(seed)
    renderer = Renderer(CAMERA, seed)
    detector = DrawnDetector(appearances, CAMERA, min_score=0.5)
    tally = Tally()
    render_ms: list[float] = []
    carry_ms: list[float] = []
    detect_ms: list[float] = []
    for _ in range(num_pictures):
        scene = random_scene(rng, height_m, appearances=appearances)
        start_s = time.thread_time()
        image = renderer.render(scene)
        rendered_s = time.thread_time()
        jpeg = np.frombuffer(encode(image, 95), np.uint8)
        image = np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), np.uint8)
        received_s = time.thread_time()
        detections = detector.detect(image, scene.pose, scene.frame.ground_down_m)
        detect_ms.append(1e3 * (time.thread_time() - received_s))
        render_ms.append(1e3 * (rendered_s - start_s))
        carry_ms.append(1e3 * (received_s - rendered_s))
        tally.add(scene, detections)
    print(f"seed {seed}, {num_pictures} pictures of {CAMERA.width_px} x {CAMERA.height_px}")
    print("\n".join(tally.lines()))
    print(f"detection, CPU median      {np.median(detect_ms):6.1f} ms  (<= 10 ms)")
    print(f"rendering, CPU median      {np.median(render_ms):6.1f} ms  (<= 6 ms)")
    print(f"JPEG both ways, CPU median {np.median(carry_ms):6.1f} ms")


def measure(
    seed: int, num_pictures: int, appearances: tuple[str, ...], height_m: float | None
) -> None:
    """Print the median traits of what is drawn, for `dronemon.vision.prototypes`."""
    rng = np.random.default_rng(seed)
    renderer = Renderer(CAMERA, seed)
    detector = DrawnDetector(appearances, CAMERA, min_score=0.5)
    traits: dict[str, list[FloatArray]] = {name: [] for name in appearances}
    for _ in range(num_pictures):
        scene = random_scene(rng, height_m, appearances=appearances, reach=1.5, num_near=4)
        image: ImageArray = renderer.render(scene)
        for candidate in detector.candidates(image, scene.pose, scene.frame.ground_down_m):
            at_m = _ground((candidate.centre_px[0], candidate.centre_px[1]), scene)
            for animal in scene.animals:
                if np.linalg.norm(at_m - animal.position_ned_m) < MATCH_M:
                    traits[animal.appearance].append(candidate.traits)
    for name, rows in traits.items():
        length_m, width_m, *coat, bands = np.median(rows, axis=0)
        shares = ", ".join(
            f'"{colour}": {share:.2f}'
            for colour, share in zip(COAT_COLOURS, coat, strict=True)
            if share >= 0.005
        )
        height_m_ = PROTOTYPES[name].height_m
        print(
            f'"{name}": Prototype({length_m:.2f}, {width_m:.2f}, {{{shares}}}, {bands:.1f}, {height_m_:.2f}),'
        )
        if VERBOSE:
            print("   ", len(rows), "sd", np.round((np.percentile(rows, 84, axis=0)-np.percentile(rows, 16, axis=0))/2, 2))


VERBOSE = True
GROUPS = {"animals": ANIMALS, "people": PEOPLE, "vehicles": VEHICLES}
"""What is in the pictures of one benchmark."""


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, help="default: 0, or 10001 with --measure")
    parser.add_argument("--pictures", type=int, default=500)
    parser.add_argument("--of", choices=[*GROUPS, "all"], default="animals", help="default: animals")
    parser.add_argument("--height-m", type=float, help="default: 35 +-20 %%")
    parser.add_argument("--measure", action="store_true", help="print the prototypes instead")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    appearances = GROUPS.get(options.of) or tuple(name for of in GROUPS.values() for name in of)
    if options.measure:
        measure(10001 if options.seed is None else options.seed, options.pictures, appearances, options.height_m)
    else:
        benchmark(options.seed or 0, options.pictures, appearances, options.height_m)


if __name__ == "__main__":
    main()
