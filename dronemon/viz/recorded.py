"""Pictures of a flight's camera, read back from its recordings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from dronemon.errors import RecordError
from dronemon.types import FloatArray
from dronemon.viz.entities import CAMERA, PICTURES

_COMPONENTS = {
    "jpeg": ("picture", "EncodedImage:blob"),
    "places": ("detections", "Points2D:positions"),
    "names": ("detections", "Points2D:labels"),
    "footprint": ("footprint", "LineStrips2D:strips"),
}
"""Of a picture -> entity under the camera, and component."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Marked:
    """A picture with what was marked in it.

    jpeg:         the picture
    detections_px: (K, 2); names: of each, with its score
    footprint_px: (M, 2) edge of what the drone is taken to see, as far as it is in the picture
    """

    jpeg: bytes
    detections_px: FloatArray
    names: tuple[str, ...]
    footprint_px: FloatArray


def picture_of(recordings: Iterable[Path], number: int) -> Marked | None:
    """The picture of a measurement, None where none was recorded. Raises RecordError."""
    for path in recordings:
        try:
            found = dict(_values(path, number))
        except (OSError, RuntimeError, ValueError) as exc:
            raise RecordError(f"{path}: cannot be read as a recording: {exc}") from exc
        if jpeg := found.get("jpeg"):
            return Marked(
                jpeg=np.array(jpeg, dtype=np.uint8).tobytes(),
                detections_px=np.array(found.get("places") or []).reshape(-1, 2),
                names=tuple(found.get("names") or ()),
                footprint_px=np.array(found.get("footprint") or []).reshape(-1, 2),
            )
    return None


def _values(path: Path, number: int) -> Iterator[tuple[str, Any]]:
    """What was recorded of this picture, by the names of `_COMPONENTS`."""
    for chunk in RrdReader(path).stream().to_chunks():
        if chunk.is_static or not chunk.entity_path.startswith(f"/{CAMERA}/"):
            continue
        batch = chunk.to_record_batch()
        if PICTURES not in batch.schema.names:
            continue
        rows = np.flatnonzero(np.array(batch.column(PICTURES)) == number).tolist()
        for name, (entity, component) in _COMPONENTS.items():
            if chunk.entity_path == f"/{CAMERA}/{entity}" and component in batch.schema.names:
                yield from ((name, batch.column(component)[row].as_py()) for row in rows)
