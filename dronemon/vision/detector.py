"""The eyes of a flight behind one protocol: a picture in, the targets found in it out."""

from __future__ import annotations

from typing import Protocol

from dronemon.types import Detection, ImageArray, Pose

DRAWN_NEEDS_PX_PER_M = 5.5
"""Size on the picture of a metre on the ground below which the drawn animals are too often missed.

Of animals in the footprint 100 % are found at 6, 97 % at 5.5, 91 % at 5, 79 % at 4.5: `python
benchmarks/vision.py --height-m H`, where the default camera has 320 / H.
"""


class Detector(Protocol):
    """Finds and names what a mission watches. It remembers nothing from picture to picture."""

    def detect(self, image: ImageArray, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        """What a picture shows of the targets.

        image:         (height, width, 3) uint8 BGR, of the camera's size, left as it is
        pose:          of the vehicle at capture
        ground_down_m: () float64 m down of the ground, in the pose's frame

        -> any number of each appearance, in any order, with scores from 0 to 1
        """
