"""What we change on a vehicle for a flight, and put back: also after a crash, at the next start.

Before anything is changed, what it was is on disk, in one small file for each vehicle in the user's
state folder. The file goes only when all in it has been put back.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path

from dronemon.durable import replace_text, sync_folder
from dronemon.errors import CommandRejected, RecordError, VehicleError
from dronemon.vehicle.link import VehicleLink
from dronemon.vehicle.parameters import as_float32

Tell = Callable[[str], None]


class Changes:
    """The changes on one vehicle. tell: is told in words what is done."""

    def __init__(self, link: VehicleLink, tell: Tell) -> None:
        self._link = link
        self._tell = tell

    async def make(self, settings: Mapping[str, float]) -> None:
        """Set parameters, each read back, once their present values are kept.

        Raises CommandRejected where a value could not be put back, OptionError, RecordError,
        LinkLost.
        """
        if not settings:
            return
        self._refuse_if_armed()
        present = await self._link.read_parameters(settings)
        for name in settings:
            if not math.isfinite(present.get(name, math.nan)):
                raise CommandRejected(
                    f"{name}: its present value cannot be read over this link, and so not be put "
                    "back; set it with a ground station"
                )
        kept = _load(self._path)
        new = {
            name: {"old": kept.get(name, {"old": present[name]})["old"], "new": as_float32(value)}
            for name, value in settings.items()
        }
        _save(self._path, kept | new)
        for name, value in settings.items():
            await self._link.write_parameter(name, value)
            self._tell(f"{name} is {value:g} for now; it was {present[name]:g}")

    async def put_back(self) -> None:
        """Put back what is kept, if anything is. Raises CommandRejected, LinkLost, RecordError."""
        if self._link.state.hardware is None or not (kept := _load(self._path)):
            return
        self._refuse_if_armed()
        present = await self._link.read_parameters(kept)
        for name, value in kept.items():
            if name not in present:
                raise CommandRejected(f"{name}, which is to be put back, is not answered for")
            if present[name] == value["new"]:
                await self._link.write_parameter(name, value["old"])
                self._tell(f"{name} is {value['old']:g} again, as before it was changed for us")
            elif present[name] != value["old"]:
                self._tell(f"{name} is left as it is: somebody changed it since we did")
        _remove(self._path)

    def last_words(self) -> str:
        """What is left set on the vehicle, as the end of a sentence; nothing where nothing is."""
        try:
            kept = _load(self._path)
        except VehicleError:  # nothing could be changed
            return ""
        except RecordError as exc:
            return f"; {exc}"
        if not kept:
            return ""
        left = [
            f"{name}={v['new']:g} is still set, and was {v['old']:g}" for name, v in kept.items()
        ]
        return f"; {', '.join(left)}: the next flight or preflight of this vehicle puts it back"

    def _refuse_if_armed(self) -> None:
        if self._link.state.is_armed:
            raise CommandRejected("it is armed: its parameters are left as they are")

    @property
    def _path(self) -> Path:
        hardware = self._link.state.hardware
        if hardware is None:
            raise CommandRejected(
                "the vehicle does not say what its board is called (AUTOPILOT_VERSION): what is "
                "changed could not be put back after a crash; set it with a ground station"
            )
        return state_folder() / f"{hardware}.json"


def state_folder() -> Path:
    """Where the user's programs keep what must outlive them. Source: XDG base directories."""
    given = os.environ.get("XDG_STATE_HOME")
    return (Path(given) if given else Path.home() / ".local" / "state") / "dronemon" / "vehicles"


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
