"""The eyes of a flight behind one protocol: a picture in, the animals found in it out."""

from __future__ import annotations

from typing import Protocol

from dronemon.types import Detection, ImageArray, Pose


class Detector(Protocol):
    """Finds and names what a mission watches. It remembers nothing from picture to picture."""

    def detect(self, image: ImageArray, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        """What a picture shows of the targets.

        image:         (height, width, 3) uint8 BGR, left as it is
        pose:          of the vehicle at capture
        ground_down_m: () float64 m down of the ground, in the pose's frame

        -> any number of each appearance, in any order, with scores from 0 to 1
        Raises CameraError if the picture is not of the size that was agreed on.
        """
