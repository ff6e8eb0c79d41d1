"""Every error that dronemon raises on purpose.

    DronemonError
      MissionFileError        the mission file cannot be flown as written      exit 2
      OptionError             an option cannot be used as given                exit 2
      VehicleError            the vehicle or the link to it                    exit 3
        LinkTimeout           nothing heard in time
        WrongVehicle          heard, but none that can be flown, or more than one
        LinkLost              heard before, silent now
        CommandRejected       the autopilot said no
        CommandUnconfirmed    the autopilot said yes, telemetry does not show it
        ControlTaken          the pilot or a failsafe chose another mode
      CameraError             no picture, or not in time                       exit 4
      BeliefError             observations a Gaussian process cannot take      exit 5
      PlannerError            no usable waypoint, or not in time               exit 5
      PolicyError             weights or features of the learned policy        exit 2
        CheckpointMismatch    the file is not the network that was asked for
      RecordError             the run folder cannot be made, written or read   exit 6
      WorkerError             a process that shares the work died              exit 6
      ViewError               the recording or live view cannot be started     exit 7

A message states the fact, the value, the limit and the next step. Foreign exceptions become one of
these at their one seam.
"""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Iterable, Iterator
from pathlib import Path


class DronemonError(Exception):
    """Base of all errors below; `exit_code` is what the command line returns for it."""

    exit_code = 1


class MissionFileError(DronemonError):
    """The mission file cannot be flown as written; the message names file, line and key."""

    exit_code = 2


class OptionError(DronemonError):
    """An option of a command, or of what it starts, cannot be used as given."""

    exit_code = 2


class VehicleError(DronemonError):
    """The vehicle, or the link to it, does not do what the mission needs."""

    exit_code = 3


class LinkTimeout(VehicleError):
    """Nothing was heard within the limit."""


class WrongVehicle(VehicleError):
    """What is heard is no vehicle that can be flown, or more than one."""


class LinkLost(VehicleError):
    """The vehicle was heard before and is silent now."""


class CommandRejected(VehicleError):
    """The autopilot refused a command."""


class CommandUnconfirmed(VehicleError):
    """The autopilot accepted a command, but telemetry never showed its effect."""


class ControlTaken(VehicleError):
    """The pilot, or a failsafe of the autopilot, chose a mode that we did not ask for."""

    def __init__(self, message: str, *, by_failsafe: bool = False) -> None:
        super().__init__(message)
        self.by_failsafe = by_failsafe


class CameraError(DronemonError):
    """No picture came, or not in time."""

    exit_code = 4


class BeliefError(DronemonError):
    """Observations that a Gaussian process cannot take."""

    exit_code = 5


class PlannerError(DronemonError):
    """The planner gave no waypoint that can be flown, or not in time."""

    exit_code = 5


class PolicyError(DronemonError):
    """Weights or features of the learned policy do not fit."""

    exit_code = 2


class CheckpointMismatch(PolicyError):
    """A checkpoint is damaged or is not the network that was asked for."""


class RecordError(DronemonError):
    """The run folder cannot be made, written or read."""

    exit_code = 6


class WorkerError(DronemonError):
    """A process that shares the work died."""

    exit_code = 6


class ViewError(DronemonError):
    """The recording or the live view cannot be started."""

    exit_code = 7


@contextlib.contextmanager
def writing(option: str, path: Path) -> Iterator[None]:
    """What a command leaves is written meanwhile. Raises OptionError with what is in the way."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as exc:
        raise OptionError(f"{option} {path}: cannot be written: {exc.strerror or exc}") from exc


@contextlib.contextmanager
def blaming(who: str, error: type[DronemonError]) -> Iterator[None]:
    """Make whatever the body's foreign code raises an error that names who did."""
    try:
        yield
    except error:
        raise
    except (Exception, SystemExit) as exc:
        raise error(f"{who} failed: {exc!r}") from exc


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A question that names what is most like it, and a space; empty if nothing is."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return "".join(f"did you mean {one}? " for one in near)
