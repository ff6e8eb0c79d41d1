"""What we change on a vehicle for a flight, and put back: also after a crash, at the next start.

Before anything is changed, what it was is on disk, in small files for each vehicle in the user's
state folder: its parameters, and its fence. A file goes only when all in it has been put back.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Self

from dronemon.durable import replace_text, sync_folder
from dronemon.errors import CommandRejected, RecordError, VehicleError
from dronemon.vehicle.fence_items import FenceItem, are_alike, item_of
from dronemon.vehicle.link import VehicleLink
from dronemon.vehicle.parameters import as_float32

Tell = Callable[[str], None]


class ChangesTaken(CommandRejected):
    """Another program flies or changes the vehicle."""


class Changes:
    """The changes on one vehicle, which one program alone may make, from the first to its end.

    tell: is told in words what is done
    """

    def __init__(self, link: VehicleLink, tell: Tell) -> None:
        self._link = link
        self._tell = tell
        self._lock: IO[str] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the vehicle to others."""
        if self._lock is not None:
            with contextlib.suppress(OSError):
                Path(self._lock.name).unlink()
            self._lock.close()
            self._lock = None

    def claim(self) -> None:
        """Keep other programs from it until the end. Raises CommandRejected, RecordError."""
        if self._lock is None:
            self._lock = _locked(self._path.with_suffix(".lock"))

    async def make(self, settings: Mapping[str, float]) -> None:
        """Set parameters, each read back, once their present values are kept.

        Raises CommandRejected where a value could not be put back, OptionError, RecordError,
        LinkLost.
        """
        if not settings:
            return
        self.claim()
        self._refuse_if_armed()
        present = await self._link.read_parameters(settings)
        for name, value in settings.items():
            as_float32(value)  # raises before anything is kept
            if not math.isfinite(present.get(name, math.nan)):
                raise CommandRejected(
                    f"{name}: the vehicle has no such parameter, or it is a whole number below 0, "
                    "which this link cannot read, and so not put back; see how it is spelt, or set "
                    "it with a ground station"
                )
        kept = _load(self._path)
        new = {
            name: {"old": kept.get(name, {"old": present[name]})["old"], "new": value}
            for name, value in settings.items()
        }
        _save(self._path, kept | new)
        for name, value in settings.items():
            await self._link.write_parameter(name, value)
            self._tell(f"{name} is {value:g} for now; it was {present[name]:g}")

    async def lay_fence(self, fence: Sequence[FenceItem]) -> None:
        """Have the vehicle keep a fence besides its own, read back, once its own is kept.

        PX4 keeps to all areas at once. Behind a circle PX4 v1.17 misreads polygons: ours is first.
        Raises CommandRejected, VehicleError, RecordError, LinkLost.
        """
        self.claim()
        self._refuse_if_armed()
        own = await self._link.read_fence()
        laid = (*fence, *own)
        _save(self._fence_path, {"old": list(map(asdict, own)), "new": list(map(asdict, laid))})
        await self._link.write_fence(laid)

    async def put_back(self) -> None:
        """Put back what is kept, if anything is. Raises CommandRejected, LinkLost, RecordError."""
        if self._link.state.hardware is not None:
            self.claim()
            try:
                await self._put_back_fence()
            except RecordError:  # keeps no parameter
                await self._put_back_parameters()
                raise
            await self._put_back_parameters()

    async def _put_back_fence(self) -> None:
        if not (kept := _load_fence(self._fence_path)):
            return
        self._refuse_if_armed()
        old, new = kept
        present = await self._link.read_fence()
        if are_alike(present, new):
            await self._link.write_fence(old)
            if old:
                self._tell(f"its own fence is back: {len(old)} corners and circles")
        elif not are_alike(present, old):
            self._tell("its fence is left as it is: somebody changed it since we did")
        _remove(self._fence_path)

    async def _put_back_parameters(self) -> None:
        if not (kept := _load(self._path)):
            return
        self._refuse_if_armed()
        present = await self._link.read_parameters(kept)
        for name, value in kept.items():
            if name not in present:
                self._tell(f"{name} is left: the vehicle does not have it any more")
            elif present[name] in (value["new"], as_float32(value["new"])):  # whole, or not
                await self._link.write_parameter(name, value["old"])
                self._tell(f"{name} is {value['old']:g} again, as before it was changed for us")
            elif present[name] != value["old"]:
                self._tell(f"{name} is left as it is: somebody changed it since we did")
        _remove(self._path)

    def last_words(self) -> str:
        """What is left set on the vehicle, as the end of a sentence; nothing where nothing is."""
        try:
            kept, fence = _load(self._path), _load_fence(self._fence_path)
        except VehicleError:  # nothing could be changed
            return ""
        except RecordError as exc:
            return f"; {exc}"
        left = [
            f"{name}={v['new']:g} is still set, and was {v['old']:g}" for name, v in kept.items()
        ]
        left += ["the flight's fence is still on it"] if fence else []
        if not left:
            return ""
        return f"; {', '.join(left)}: the next flight or preflight of this vehicle puts it back"

    def _refuse_if_armed(self) -> None:
        if self._link.state.is_armed:
            raise CommandRejected("it is armed: its parameters and its fence are left as they are")

    @property
    def _path(self) -> Path:
        hardware = self._link.state.hardware
        if hardware is None:
            raise CommandRejected(
                "the vehicle's board does not say its own number (AUTOPILOT_VERSION): what is "
                "changed could not be put back after a crash; set it with a ground station"
            )
        return state_folder() / f"{hardware}.json"

    @property
    def _fence_path(self) -> Path:
        return self._path.with_suffix(".fence.json")


def state_folder() -> Path:
    """Where the user's programs keep what must outlive them. Source: XDG base directories."""
    given = os.environ.get("XDG_STATE_HOME")
    return (Path(given) if given else Path.home() / ".local" / "state") / "dronemon" / "vehicles"


def _locked(path: Path) -> IO[str]:
    """A file that no other program locks meanwhile. Raises CommandRejected, RecordError."""
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("w", encoding="utf-8")
        except OSError as exc:
            raise RecordError(f"cannot write {path}: {exc.strerror}; nothing was changed") from exc
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(path.stat(), os.fstat(file.fileno())):
                    return file
        except BlockingIOError as exc:
            file.close()
            raise ChangesTaken(
                "another program flies or changes this vehicle: end that one first (simulated "
                "vehicles may share a board: give each program an XDG_STATE_HOME of its own)"
            ) from exc
        file.close()  # the program before removed it meanwhile


def _load(path: Path) -> dict[str, dict[str, float]]:
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        return {
            str(name): {"old": float(value["old"]), "new": float(value["new"])}
            for name, value in kept.items()
        }
    except FileNotFoundError:
        return {}
    except (OSError, LookupError, TypeError, ValueError, AttributeError) as exc:
        raise RecordError(
            f"{path} cannot be read: {exc!r}; it holds what parameters of the vehicle were before "
            "they were changed: set them with a ground station, then remove it"
        ) from exc


def _load_fence(path: Path) -> tuple[tuple[FenceItem, ...], tuple[FenceItem, ...]] | None:
    """What the fence was and what it became; None if none is kept. Raises RecordError."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        old, new = (tuple(item_of(fields) for fields in kept[key]) for key in ("old", "new"))
    except FileNotFoundError:
        return None
    except (OSError, LookupError, TypeError, ValueError, AttributeError, VehicleError) as exc:
        raise RecordError(
            f"{path} cannot be read: {exc!r}; it holds the vehicle's own fence: upload that with a "
            "ground station, then remove it"
        ) from exc
    return old, new


def _save(path: Path, kept: Mapping[str, object]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_text(path, json.dumps(kept))
    except OSError as exc:
        raise RecordError(
            f"cannot keep the present values in {path}: {exc.strerror}; nothing was changed"
        ) from exc


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):  # all in it is then found to be put back
        path.unlink()
        sync_folder(path.parent)
