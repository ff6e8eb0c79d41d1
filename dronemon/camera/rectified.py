"""Pictures of a lens, made those of a perfect camera."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Self

import numpy as np

from dronemon.camera.source import FrameSource, check_shows, check_size
from dronemon.types import CameraModel, ImageArray, Picture


class RectifiedCamera:
    """Another source's pictures as a perfect camera would have taken them; a `FrameSource`."""

    def __init__(
        self,
        source: FrameSource,
        rectify: Callable[[ImageArray], ImageArray],
        model: CameraModel,
    ) -> None:
        self._source, self._rectify, self._model = source, rectify, model

    async def __aenter__(self) -> Self:
        blank = np.zeros((self._model.height_px, self._model.width_px, 3), np.uint8)
        await asyncio.to_thread(self._rectify, blank)  # the first one takes seconds
        await self._source.__aenter__()
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self._source.__aexit__(*exc)

    async def capture(self) -> Picture:
        """The source's next picture, rectified. Raises CameraError, for another size, too."""
        picture = await self._source.capture()
        check_size(picture.image, self._model)
        check_shows(picture.image)  # beside black corners, which have contrast
        image = await asyncio.to_thread(self._rectify, picture.image)
        return Picture(time_s=picture.time_s, image=image)
