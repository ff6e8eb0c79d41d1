"""Whether the vehicle flies in a mode that we asked for: a pilot's or a failsafe's choice wins."""

from __future__ import annotations

from dronemon.errors import ControlTaken
from dronemon.vehicle.link import Mode, VehicleState


class ModeWatch:
    """The modes that are ours; at first every one is."""

    def __init__(self) -> None:
        self._expected: frozenset[Mode] | None = None  # None: any

    def expect(self, *modes: Mode) -> None:
        """From now on these are ours."""
        self._expected = frozenset(modes)

    def expect_also(self, mode: Mode, present: Mode) -> None:
        """While a command is under way the mode is still the present one, or what we asked."""
        self._expected = (self._expected or frozenset({present})) | {mode}

    @property
    def is_released(self) -> bool:
        """Whether any mode is welcome: others fly, or nobody does yet."""
        return self._expected is None

    def release(self) -> None:
        """From now on any mode is welcome: whoever chose it is in control."""
        self._expected = None

    def check(self, state: VehicleState) -> None:
        """Raise ControlTaken if the mode that flies is none of ours; with motors off none does."""
        if self._expected is not None and state.is_armed and state.mode not in self._expected:
            who = "a failsafe of the autopilot" if state.is_failsafe else "the pilot"
            raise ControlTaken(
                f"{who} chose mode '{state.mode}' where "
                f"'{' or '.join(sorted(self._expected))}' was ours",
                by_failsafe=state.is_failsafe,
            )
