"""How well detectors find what the simulator draws: `python benchmarks/vision.py [--of GROUP]`.

Each picture has a random place, heading, height (35 m +-20 %) and tilt (up to 15 degrees) over a
random area of 200 m with one target of every appearance of a group, at least one of them near the
vehicle, and goes through the JPEG of the stream. With `--height-m H` the height is H and the area
H/35 as large. A target counts for recall if it is drawn wholly inside both the sensor's circle and
the picture.

`--network FILE` measures one in an ONNX file in place of the drawn detector.

`--conditions` shows all appearances together, from 32 m (10 pixels a metre) in ten worlds, and is
less kind in one way after the other. `dronemon.vision.prototypes` was measured on other seeds
(`--measure`, 10001 and up). `--conditions markers` shows ground robots that the marker detector
tells apart, and `--conditions blobs` people of whom one wears the colour that is looked for.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from dronemon.errors import OptionError
from dronemon.frames import ground_to_pixel, pixel_to_ground
from dronemon.mission.detector import DetectorSection
from dronemon.mission.schema import Simulation
from dronemon.problem import SENSOR_RADIUS_AU
from dronemon.types import (
    ANIMALS,
    APPEARANCES,
    PEOPLE,
    VEHICLES,
    CameraModel,
    Detection,
    FloatArray,
    ImageArray,
)
from dronemon.vision.detector import Detector
from dronemon.vision.drawn import DrawnDetector
from dronemon.vision.prototypes import COAT_COLOURS
from dronemon.vision.registry import detector_of
from sim.camera import decode, encode
from sim.random_scene import random_scene
from sim.renderer import Renderer
from sim.robots import look_of
from sim.scene import Animal, Scene
from sim.sprites import drawn_size_m

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.pi / 2.0)
GROUPS = {"animals": ANIMALS, "people": PEOPLE, "vehicles": VEHICLES}
FAMILY, SIDE_M = "4x4_50", 1.5
"""Of the robots' markers."""
NUM_WORLDS = 10
SPEED_M_S, TURN_RAD_S = 8.0, 0.3
"""Of the vehicle while the shutter is open: a brisk flight that begins to turn."""
CONDITIONS = {
    "kind": Simulation(),
    "tilted to 20 degrees": Simulation(),
    "shutter 10 ms": Simulation(exposure_s=0.01),
    "shutter 30 ms": Simulation(exposure_s=0.03),
    "light 1/4": Simulation(light=0.25),
    "light 1/16": Simulation(light=1.0 / 16.0),
    "clouds 30 %": Simulation(shadow=0.3),
    "clouds 60 %": Simulation(shadow=0.6),
    "JPEG 75": Simulation(jpeg_quality=75),
    "JPEG 40": Simulation(jpeg_quality=40),
}
MIN_SCORE = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """What is shown in all conditions, and as what a detector is to find it.

    called:  of each look that is watched, what the detector calls it
    others:  looks that are shown, and are not to be found
    groups:  the table's columns of recall, looks of each
    section: the detector's
    """

    called: dict[str, str]
    others: tuple[str, ...] = ()
    groups: dict[str, tuple[str, ...]]
    height_m: float
    section: DetectorSection = field(default_factory=DetectorSection)

    @property
    def looks(self) -> tuple[str, ...]:
        """All that is shown."""
        return (*self.called, *self.others)


def _robots() -> Subject:
    called = {look_of(FAMILY, number, SIDE_M): number for number in ("3", "7", "11", "15", "19")}
    section = DetectorSection(kind="markers", family=FAMILY, side_m=SIDE_M)
    return Subject(called=called, groups={"robots": tuple(called)}, height_m=20.0, section=section)


def _jackets() -> Subject:
    section = DetectorSection(kind="blobs", hue_deg=(10.0, 35.0), saturation=0.6, size_m=(0.2, 1.0))
    orange = {"person-orange": "person-orange"}
    return Subject(
        called=orange,
        others=tuple(look for look in PEOPLE if look not in orange),
        groups={"orange jackets": tuple(orange)},
        height_m=20.0,
        section=section,
    )


SUBJECTS = {
    "drawn": Subject(called={name: name for name in APPEARANCES}, groups=GROUPS, height_m=32.0),
    "markers": _robots(),
    "blobs": _jackets(),
}
MATCH_M = 2.5
"""A detection this near to an animal is of that animal."""


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
    """Counts over all pictures. called: of each look that is to be found, what it is called."""

    called: dict[str, str]
    num_pictures: int = 0
    num_whole: Counter[str] = field(default_factory=Counter)
    num_found: Counter[str] = field(default_factory=Counter)
    num_right: int = 0
    num_wrong: int = 0
    num_false: int = 0
    errors_m: list[float] = field(default_factory=list)
    detect_ms: list[float] = field(default_factory=list)

    def add(self, scene: Scene, detections: tuple[Detection, ...]) -> None:
        """Compare what was found in one picture with what is there."""
        positions_m = np.array([a.position_ned_m for a in scene.animals])
        named = set()
        for detection in detections:
            distance_m = np.linalg.norm(positions_m - _ground(detection.pixel_px, scene), axis=1)
            nearest = int(distance_m.argmin())
            if distance_m[nearest] >= MATCH_M:
                self.num_false += 1
            elif self.called.get(scene.animals[nearest].appearance) != detection.appearance:
                self.num_wrong += 1
            else:
                self.num_right += 1
                named.add(nearest)
                if is_whole(scene, scene.animals[nearest]):
                    self.errors_m.append(float(distance_m[nearest]))
        self.num_pictures += 1
        for i, animal in enumerate(scene.animals):
            if animal.appearance in self.called and is_whole(scene, animal):
                self.num_whole[animal.appearance] += 1
                self.num_found[animal.appearance] += i in named

    def recall(self, looks: Iterable[str]) -> float:
        """Share of those wholly in view that were found and named right."""
        num_whole = sum(self.num_whole[look] for look in looks)
        return sum(self.num_found[look] for look in looks) / max(num_whole, 1)

    @property
    def precision(self) -> float:
        """Share of the finds that are there and named right."""
        return self.num_right / max(self.num_right + self.num_wrong + self.num_false, 1)

    @property
    def accuracy(self) -> float:
        """Share of the finds of something that are named right."""
        return self.num_right / max(self.num_right + self.num_wrong, 1)

    @property
    def error_m(self) -> tuple[float, float]:
        """Median and 95th percentile of how far finds are from where the targets are."""
        median_m, p95_m = np.percentile(self.errors_m or [np.nan], [50.0, 95.0])
        return float(median_m), float(p95_m)

    def lines(self) -> Iterator[str]:
        """The table, with the limit of each figure."""
        median_m, p95_m = self.error_m
        num_whole = self.num_whole.total()
        num_finds = self.num_right + self.num_wrong + self.num_false
        recall = self.recall(self.called)
        yield f"recall                     {recall:8.2%}   (>= 97 %)   {num_whole} targets"
        yield f"precision                  {self.precision:8.2%}   (>= 99 %)   {num_finds} finds"
        yield f"named right                {self.accuracy:8.2%}   (>= 99.5 %)"
        yield f"ground error, median       {median_m:6.2f} m   (<= 0.5 m)"
        yield f"ground error, 95 %         {p95_m:6.2f} m   (<= 1.5 m)"
        yield f"detection, CPU median      {np.median(self.detect_ms):6.1f} ms"
        for look in self.called:
            if self.num_found[look] < self.num_whole[look]:
                yield f"    {look}: {self.num_found[look]} of {self.num_whole[look]}"


def section_of(network: Path | None, min_score: float) -> DetectorSection:
    """The detector of drawings that is measured."""
    if network is None:
        return DetectorSection(min_score=min_score)
    return DetectorSection(kind="onnx", file=str(network), min_score=min_score)


def look(tally: Tally, scene: Scene, renderer: Renderer, detector: Detector, quality: int) -> None:
    """Take one picture, and count what is found in it."""
    image = decode(encode(renderer.render(scene), quality))
    received_s = time.thread_time()
    detections = detector.detect(image, scene.pose, scene.frame.ground_down_m)
    tally.detect_ms.append(1e3 * (time.thread_time() - received_s))
    tally.add(scene, detections)


def _ground(pixel_px: tuple[float, float], scene: Scene) -> FloatArray:
    return pixel_to_ground(np.array(pixel_px), CAMERA, scene.pose, scene.frame.ground_down_m)


def benchmark(
    detector: Detector,
    seed: int,
    num_pictures: int,
    appearances: tuple[str, ...],
    height_m: float | None,
) -> None:
    """Print how well and how fast targets of a group are found."""
    rng = np.random.default_rng(seed)
    renderer = Renderer(CAMERA, seed)
    tally = Tally(called={name: name for name in appearances})
    for _ in range(num_pictures):
        scene = random_scene(rng, height_m, appearances=appearances)
        look(tally, scene, renderer, detector, Simulation().jpeg_quality)
    print(f"seed {seed}, {num_pictures} pictures of {CAMERA.width_px} x {CAMERA.height_px}")
    print("\n".join(tally.lines()))


def compare(subject: Subject, seed: int, num_pictures: int) -> None:
    """Print what unkind pictures do to a detector, a line of Markdown for each condition."""
    detector = detector_of(subject.section, list(subject.called.values()), CAMERA)
    tallies = {name: Tally(called=subject.called) for name in CONDITIONS}
    num_each = math.ceil(num_pictures / len(CONDITIONS) / NUM_WORLDS)
    for world in range(seed, seed + NUM_WORLDS):
        for name, simulation in CONDITIONS.items():
            rng = np.random.default_rng(world)  # the same scenes for all
            renderer = Renderer(CAMERA, world, simulation)
            for _ in range(num_each):
                scene = unkind_scene(rng, subject, 20.0 if "tilted" in name else 15.0)
                look(tallies[name], scene, renderer, detector, simulation.jpeg_quality)
    print(
        f"seeds {seed} to {world}, {num_each * NUM_WORLDS} pictures each, {subject.height_m:g} m\n"
    )
    groups = subject.groups
    print(f"| pictures | recall: {' | '.join(groups)} | precision | named right | error | time |")
    print("|---" * (5 + len(groups)) + "|")
    for name, tally in tallies.items():
        recalls = " | ".join(f"{tally.recall(of):.1%}" for of in groups.values())
        median_m, p95_m = tally.error_m
        print(
            f"| {name} | {recalls} | {tally.precision:.1%} | {tally.accuracy:.1%} | "
            f"{median_m:.2f}, {p95_m:.2f} m | {np.median(tally.detect_ms):.0f} ms |"
        )


def unkind_scene(rng: np.random.Generator, subject: Subject, max_tilt_deg: float) -> Scene:
    """A scene with all looks, three of them near, as a drone sees it that moves and turns."""
    scene = random_scene(
        rng,
        subject.height_m,
        appearances=subject.looks,
        num_near=3,
        max_tilt_rad=math.radians(max_tilt_deg),
    )
    way, turn = rng.uniform(0.0, math.tau, 2)
    velocity_m_s = (SPEED_M_S * math.cos(way), SPEED_M_S * math.sin(way), 0.0)
    turn_rad_s = (TURN_RAD_S * math.cos(turn), TURN_RAD_S * math.sin(turn), 0.0)
    pose = replace(scene.pose, velocity_ned_m_s=velocity_m_s)
    return replace(scene, pose=pose, turn_rad_s=turn_rad_s)


def measure(
    seed: int, num_pictures: int, appearances: tuple[str, ...], height_m: float | None
) -> None:
    """Print the median traits of what is drawn, for `dronemon.vision.prototypes`."""
    rng = np.random.default_rng(seed)
    renderer = Renderer(CAMERA, seed)
    detector = DrawnDetector(appearances, CAMERA, MIN_SCORE)
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
        print(f"{name}: {length_m:.2f}, {width_m:.2f}, {{{shares}}}, {bands:.1f}")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, help="default: 0, or 10001 with --measure")
    parser.add_argument("--pictures", type=int, help="default: 500, or 1000 with --conditions")
    parser.add_argument("--of", choices=[*GROUPS], default="animals", help="default: animals")
    parser.add_argument("--height-m", type=float, help="default: 35 +-20 %%")
    parser.add_argument("--network", type=Path, help="an ONNX file, in place of the drawn detector")
    parser.add_argument("--min-score", type=float, default=MIN_SCORE, help=f"default: {MIN_SCORE}")
    modes = parser.add_mutually_exclusive_group()
    modes.add_argument("--measure", action="store_true", help="print the prototypes instead")
    what = "print a table of unkind pictures instead; of drawings if nothing is said"
    modes.add_argument("--conditions", nargs="?", const="drawn", choices=[*SUBJECTS], help=what)
    options = parser.parse_args()
    is_drawn = not options.measure and options.conditions in (None, "drawn")
    if not is_drawn and (options.network or options.min_score != MIN_SCORE):
        parser.error("--network and --min-score are for drawings; leave them out")
    if options.conditions and options.height_m:
        parser.error("--conditions has its own heights; leave --height-m out")
    if min(options.pictures or 1, options.height_m or 1.0) <= 0 or (options.seed or 0) < 0:
        parser.error("--pictures and --height-m are above 0, --seed 0 or more")
    cv2.setNumThreads(1)
    pictures, of = options.pictures or 500, GROUPS[options.of]
    section = section_of(options.network, options.min_score)
    try:
        if options.measure:
            seed = 10001 if options.seed is None else options.seed
            measure(seed, pictures, of, options.height_m)
        elif options.conditions:
            subject = SUBJECTS[options.conditions]
            if options.conditions == "drawn":
                subject = replace(subject, section=section)
            compare(subject, options.seed or 0, options.pictures or 1000)
        else:
            detector = detector_of(section, of, CAMERA)
            benchmark(detector, options.seed or 0, pictures, of, options.height_m)
    except OptionError as exc:
        raise SystemExit(f"--network: {exc}") from exc


if __name__ == "__main__":
    main()
