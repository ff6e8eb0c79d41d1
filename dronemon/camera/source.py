"""What every camera offers: a picture taken as close to now as it can."""

from __future__ import annotations

from typing import Protocol, Self

from dronemon.types import Picture


class FrameSource(Protocol):
    """A stream of pictures with their capture times. It is open inside its `async with`."""

    async def __aenter__(self) -> Self:
        """Open the stream. Raises CameraError if it cannot be opened in time."""

    async def __aexit__(self, *exc: object) -> None:
        """Close the stream."""

    async def capture(self) -> Picture:
        """A picture taken as close to now as the source can.

        Raises CameraError when none came in time or the stream was lost. The next call tries again,
        with a new connection where that helps.
        """
