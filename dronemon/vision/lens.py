"""How a real camera sees: its lens, how it is mounted, and pictures as a perfect one would see.

All else knows one camera: a pinhole that looks straight down from a level vehicle, the picture's
top towards its nose. `Rectifier` makes the pictures of any other camera those of such a one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from dronemon.errors import CameraError
from dronemon.frames import body_to_ned
from dronemon.mission import Mission
from dronemon.types import CameraModel, FloatArray, ImageArray, Vector3

_MAX_BYTES = 2**20
_COUNTS = (4, 5, 8, 12, 14)
"""Numbers of coefficients of OpenCV's lens; its fisheye lens has the first."""
_CAMERA_TO_BODY = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From right, down the picture, ahead of the lens to forward, right, down."""
_ROUND_TRIP_PX = 0.5
"""A pixel whose way through the lens and back ends farther off is beyond what the lens shows."""
_UNREADABLE = (
    *(yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError),
    *(ArithmeticError, RecursionError),
)
"""What reading a file in YAML of anybody may end in."""
_PLAIN = (None, "plumb_bob", "rational_polynomial", "thin_prism")
_FISHEYE = ("equidistant", "fisheye")
"""Names of lenses, OpenCV's plain one and its fisheye."""
_FOCAL = (1.0, 1e6)
_NOWHERE_PX = -10.0
_BLOCK = 64
"""Rows of a map that are made at a time: all of a large picture would take gigabytes."""
_NAMES = {
    "matrix": ("camera_matrix", "cameraMatrix", "K"),
    "distortion": ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D"),
    "width": ("image_width", "width"),
    "height": ("image_height", "height"),
}
"""Keys by which files of OpenCV and of ROS have what is needed."""


class _Loader(yaml.SafeLoader):
    """Reads matrices as OpenCV writes them, too, and no alias, which may unfold without end."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """The next node. Raises YAMLError for an alias."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it has aliases")
        return super().compose_node(parent, index)


def _opencv_matrix(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """Intrinsics of a camera.

    matrix:     (3, 3) float64 focal lengths and centre in pixels
    distortion: (k,)   float64 OpenCV's coefficients; four of its fisheye lens if `is_fisheye`
    """

    width_px: int
    height_px: int
    matrix: FloatArray
    distortion: FloatArray
    is_fisheye: bool = False

    @classmethod
    def of(cls, model: CameraModel) -> Lens:
        """A pinhole without distortion."""
        return cls(
            width_px=model.width_px,
            height_px=model.height_px,
            matrix=_matrix(model),
            distortion=np.zeros(4),
        )

    @classmethod
    def read(cls, path: Path) -> Lens:
        """A calibration as OpenCV, ROS or `dronemon calibrate` writes it. Raises CameraError."""
        try:
            with path.open("rb") as file:
                text = file.read(_MAX_BYTES + 1).decode()
        except (OSError, UnicodeDecodeError) as exc:
            raise CameraError(f"{path}: cannot be read: {exc}") from exc
        if len(text) > _MAX_BYTES:
            raise CameraError(f"{path}: is too large for a calibration")
        if text.startswith("%YAML:1.0"):  # OpenCV's way to say so, which is not YAML
            text = text.partition("\n")[2]
        try:
            data = yaml.load(text, _Loader)
            return cls._parse(data)
        except _UNREADABLE as exc:
            raise CameraError(
                f"{path}: no calibration as OpenCV, ROS or `dronemon calibrate intrinsics` "
                f"writes it: {exc}"
            ) from exc

    @classmethod
    def _parse(cls, data: Any) -> Lens:
        if not isinstance(data, dict):
            raise ValueError("it has no keys")
        matrix, distortion = (_numbers(_get(data, name)) for name in ("matrix", "distortion"))
        width, height = (_get(data, name) for name in ("width", "height"))
        model = data.get("distortion_model")
        if model not in _PLAIN + _FISHEYE:
            raise ValueError(f"its distortion_model {model!r} is not known")
        is_fisheye = model in _FISHEYE or bool(data.get("fisheye_model"))
        if type(width) is not int or type(height) is not int or min(width, height) < 1:
            raise ValueError("its size is no two whole numbers")
        if matrix.size != 9 or not _is_intrinsic(matrix.reshape(3, 3)):
            raise ValueError(
                "its camera matrix is not [[f, 0, u], [0, f, v], [0, 0, 1]] with focal lengths f"
                f" of {_FOCAL[0]:g} to {_FOCAL[1]:g} pixels"
            )
        counts = _COUNTS[:1] if is_fisheye else _COUNTS
        if distortion.size not in counts:
            raise ValueError(f"it has {distortion.size} distortion coefficients, not {counts}")
        matrix = matrix.reshape(3, 3)
        if not (0.0 < matrix[0, 2] < width and 0.0 < matrix[1, 2] < height):
            raise ValueError("the lens's centre lies outside the picture")
        return cls(
            width_px=width,
            height_px=height,
            matrix=matrix,
            distortion=distortion.ravel(),
            is_fisheye=is_fisheye,
        )

    def text(self) -> str:
        """What `read` reads."""
        return yaml.safe_dump(
            {
                "image_width": self.width_px,
                "image_height": self.height_px,
                "distortion_model": "equidistant" if self.is_fisheye else "plumb_bob",
                "camera_matrix": {"rows": 3, "cols": 3, "data": self.matrix.ravel().tolist()},
                "distortion_coefficients": {
                    "rows": 1,
                    "cols": self.distortion.size,
                    "data": self.distortion.tolist(),
                },
            },
            sort_keys=False,
        )

    def rays(self, pixels_px: FloatArray) -> FloatArray:
        """Where pixels look. (M, 2) u, v -> (M, 3) right, down the picture, 1 ahead."""
        undistort = cv2.fisheye.undistortPoints if self.is_fisheye else cv2.undistortPoints
        plane = undistort(pixels_px.reshape(-1, 1, 2), self.matrix, self.distortion)
        return np.column_stack([np.asarray(plane, np.float64).reshape(-1, 2), np.ones(len(plane))])

    def pixels(self, rays: FloatArray) -> FloatArray:
        """Where rays are seen, (M, 3) -> (M, 2) u, v; NaN behind the camera."""
        ahead = rays[:, 2] > 1e-6
        plane = np.where(
            ahead[:, None], rays[:, :2] / np.where(ahead, rays[:, 2], 1.0)[:, None], 0.0
        )
        if self.is_fisheye:
            seen = cv2.fisheye.distortPoints(plane.reshape(-1, 1, 2), self.matrix, self.distortion)
        else:
            points = np.column_stack([plane, np.ones(len(plane))])
            seen, _ = cv2.projectPoints(
                points, np.zeros(3), np.zeros(3), self.matrix, self.distortion
            )
        return np.where(ahead[:, None], np.asarray(seen, np.float64).reshape(-1, 2), np.nan)


class Rectifier:
    """Makes the pictures of a lens those of a perfect camera, and the other way round."""

    def __init__(self, lens: Lens, mount_rad: Vector3, model: CameraModel) -> None:
        """mount_rad: roll, pitch, yaw of the camera on the vehicle; none looks straight down."""
        self._lens, self._model = lens, model
        self._turn = _CAMERA_TO_BODY.T @ body_to_ned(mount_rad) @ _CAMERA_TO_BODY
        self._perfect = Lens.of(model)

    @classmethod
    def of_mission(cls, mission: Mission) -> Rectifier | None:
        """That of a mission's camera; None if it is a perfect one. Raises CameraError."""
        camera = mission.camera
        if camera.calibration is None and not any(camera.mount_deg):
            return None
        model = camera.model
        lens = Lens.of(model) if camera.calibration is None else Lens.read(Path(camera.calibration))
        if (lens.width_px, lens.height_px) != (model.width_px, model.height_px):
            raise CameraError(
                f"{camera.calibration}: is for pictures of {lens.width_px} x {lens.height_px} "
                f"pixels, the mission's are {model.width_px} x {model.height_px}; calibrate anew, "
                "or set camera.width_px and camera.height_px to what the camera sends"
            )
        roll, pitch, yaw = (math.radians(angle) for angle in camera.mount_deg)
        return cls(lens, (roll, pitch, yaw), model)

    def __call__(self, image: ImageArray) -> ImageArray:
        """What a perfect camera would have seen; black where the real one does not look."""
        return np.asarray(cv2.remap(image, *self._inwards, cv2.INTER_LINEAR), np.uint8)

    def as_seen(self, image: ImageArray) -> ImageArray:
        """What the real camera sees of what a perfect one would; for simulators."""
        border = cv2.BORDER_REPLICATE
        seen = cv2.remap(image, *self._outwards, cv2.INTER_LINEAR, borderMode=border)
        return np.asarray(seen, np.uint8)

    @cached_property
    def _inwards(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        return self._mapping(self._seen_at)

    @cached_property
    def _outwards(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        return self._mapping(self._perfect_at)

    @property
    def focal_px(self) -> float:
        """How much of the ground the lens tells: its focal length, or the perfect one's if less."""
        return min(self._model.focal_px, float(self._lens.matrix[0, 0]))

    def sees_circle(self) -> bool:
        """Whether the real camera shows the largest circle about the perfect picture's middle."""
        middle_px = self._perfect.matrix[:2, 2]
        shares, angles = np.meshgrid(np.linspace(0.1, 1.0, 10), np.linspace(0.0, math.tau, 65))
        radius_px = shares.ravel() * middle_px.min()
        circle = np.column_stack([np.cos(angles.ravel()), np.sin(angles.ravel())])
        return bool(np.isfinite(self._seen_at(middle_px + radius_px[:, None] * circle)).all())

    def _seen_at(self, pixels_px: FloatArray) -> FloatArray:
        """Pixels of the real picture, NaN where there are none, for (M, 2) of the perfect one."""
        seen_px = self._lens.pixels(self._perfect.rays(pixels_px) @ self._turn)
        size_px = np.array([self._lens.width_px, self._lens.height_px])
        inside = ((seen_px >= 0.0) & (seen_px <= size_px - 1.0)).all(axis=1)
        back_px = np.full_like(seen_px, np.nan)
        if inside.any():
            back_px[inside] = self._perfect_at(seen_px[inside])
        # Beyond its angle of view the polynomial of a lens may lead back into the picture.
        off_px = np.linalg.norm(back_px - pixels_px, axis=1)
        return np.where((off_px <= _ROUND_TRIP_PX)[:, None], seen_px, np.nan)

    def _perfect_at(self, pixels_px: FloatArray) -> FloatArray:
        """Pixels of the perfect picture for (M, 2) of the real one; NaN beyond its horizon."""
        return self._perfect.pixels(self._lens.rays(pixels_px) @ self._turn.T)

    def _mapping(
        self, of: Callable[[FloatArray], FloatArray]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """For each pixel of one picture where it lies in the other, or outside of that."""
        height, width = self._model.height_px, self._model.width_px
        x, y = (np.empty((height, width), np.float32) for _ in range(2))
        for first in range(0, height, _BLOCK):
            last = min(first + _BLOCK, height)
            rows, columns = np.mgrid[first:last, :width]
            there_px = of(np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64))
            there_px = np.nan_to_num(there_px, nan=_NOWHERE_PX).clip(-1e6, 1e6)
            x[first:last], y[first:last] = (there_px[:, i].reshape(rows.shape) for i in (0, 1))
        return x, y


def _matrix(model: CameraModel) -> FloatArray:
    """Of a pinhole, whose pixel (0, 0) has its middle half a pixel from the picture's corner."""
    centre = (model.width_px - 1) / 2.0, (model.height_px - 1) / 2.0
    focal = model.focal_px
    return np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])


def _get(data: Mapping[str, Any], what: str) -> Any:
    for name in _NAMES[what]:
        if name in data:
            return data[name]
    raise ValueError(f"it has no {_NAMES[what][0]}")


def _is_intrinsic(matrix: FloatArray) -> bool:
    zeros_and_one = np.array_equal(matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], [0, 0, 0, 0, 1])
    focal = matrix[[0, 1], [0, 1]]
    return bool(zeros_and_one and (focal >= _FOCAL[0]).all() and (focal <= _FOCAL[1]).all())


def _numbers(given: Any) -> FloatArray:
    """Numbers in rows, in a list, or under `data`, as files have them."""
    numbers = np.array(given["data"] if isinstance(given, dict) else given, dtype=np.float64)
    if not np.isfinite(numbers).all():
        raise ValueError("it has numbers that are not finite")
    return numbers
