"""The eyes of a flight behind one protocol: a picture in, the animals found in it out."""

from __future__ import annotations

from typing import Protocol

from dronemon.errors import CameraError
from dronemon.types import CameraModel, Detection, ImageArray, Pose

NEEDED_PX_PER_M = 5.5
"""Size on the picture of a metre on the ground below which too many animals are missed or mistaken.

Of animals in the footprint 100 % are found at 6, 97 % at 5.5, 91 % at 5, 79 % at 4.5: `python
benchmarks/vision.py --height-m H`, where the default camera has 320 / H.
"""


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


def check_size(image: ImageArray, camera: CameraModel) -> None:
    """See whether a picture is the camera's. Raises CameraError if not."""
    expected = (camera.height_px, camera.width_px, 3)
    if image.shape != expected:
        raise CameraError(
            f"a picture of shape {image.shape} came, {expected} was expected; "
            "does the mission's camera section describe this camera?"
        )
