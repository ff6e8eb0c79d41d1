"""Pictures that lie on a disk, or come from any video, one after the other without a clock."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from dronemon.camera.video import open_video
from dronemon.errors import CameraError
from dronemon.types import ImageArray

SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp"}
_TIMEOUT_MS = 10_000


def pictures_of(source: str) -> Iterator[tuple[str, ImageArray]]:
    """Name and picture (height, width, 3), uint8 BGR, of each in a file, a folder or a video.

    source: of a video also the URL of a stream, or the number of a device

    Raises CameraError.
    """
    path = Path(source)
    if path.is_dir():
        for file in picture_files(path):
            yield file.name, read_picture(file)
    elif path.suffix.lower() in SUFFIXES:
        yield path.name, read_picture(path)
    else:
        yield from _frames(source)


def picture_files(folder: Path) -> list[Path]:
    """A folder's pictures by their names, one at least. Raises CameraError."""
    try:
        files = sorted(
            f for f in folder.iterdir() if f.suffix.lower() in SUFFIXES and f.name[0] != "."
        )
    except OSError as exc:
        raise CameraError(f"{folder}: no folder that can be read: {exc.strerror}") from exc
    if not files:
        raise CameraError(f"{folder}: no pictures in it; read are {', '.join(sorted(SUFFIXES))}")
    return files


def read_picture(path: Path) -> ImageArray:
    """A picture as it is stored: a camera's, which no flag has turned upright.

    Raises CameraError.
    """
    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(data, flags)
    except (OSError, cv2.error) as exc:
        raise CameraError(f"{path}: cannot be read: {exc}") from exc
    if image is None:
        raise CameraError(f"{path}: is no picture that can be read")
    if image.dtype != np.uint8:
        raise CameraError(
            f"{path}: has {image.dtype} values; make them 8 bits, as a stream has them"
        )
    return np.asarray(image, np.uint8)


def _frames(source: str) -> Iterator[tuple[str, ImageArray]]:
    video = open_video(int(source) if re.fullmatch("[0-9]{1,5}", source) else source, _TIMEOUT_MS)
    try:
        number, (is_read, image) = 0, video.read()
        if not is_read:
            raise CameraError(
                f"{source}: no picture, folder, video or stream that can be read; is it right?"
            )
        while is_read:
            number += 1
            yield f"{number:06d}", np.asarray(image, np.uint8)
            is_read, image = video.read()
    finally:
        video.release()
