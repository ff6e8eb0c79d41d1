"""Has the gimbal look straight down, and sees that it does."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable

from dronemon.errors import CommandRejected, CommandUnconfirmed
from dronemon.frames import camera_to_ned, off_down_rad
from dronemon.mission.schema import GIMBAL_ERROR_DEG
from dronemon.vehicle.gimbal import GIMBAL_COMPONENTS, GIMBAL_MESSAGES
from dronemon.vehicle.hearing import Hearing
from dronemon.vehicle.px4 import ACCEPTED, LOOK_DOWN, Command
from dronemon.vehicle.wire import Wire

_ATTEMPTS = 3
_WANTED_HZ = 10.0


async def point_down(
    wire: Wire, heard: Hearing, attempt_timeout_s: float, check: Callable[[], None]
) -> None:
    """Take control of the gimbal and have it look down, three times at most; yaw is the vehicle's.

    attempt_timeout_s: vehicle time for each
    check:             raises what forbids to command anything
    Raises CommandRejected, CommandUnconfirmed, LinkLost, and what `check` raises.
    """
    for message_id in GIMBAL_MESSAGES.values():
        with contextlib.suppress(CommandUnconfirmed):  # a gimbal of its own sends it unasked
            await wire.command(Command.stream(message_id, _WANTED_HZ), check)
    problem: CommandRejected | CommandUnconfirmed | None = None
    for _ in range(_ATTEMPTS):
        if problem := await _refusal(wire, check):
            continue
        problem = await _what_is_seen(heard, attempt_timeout_s)
        if problem is None:
            return
    assert problem is not None
    raise problem


async def _refusal(wire: Wire, check: Callable[[], None]) -> CommandRejected | None:
    """Ask. -> why it is not obeyed, if it is not"""
    commands = {"taking control": Command.take_gimbal(*wire.own), "looking down": LOOK_DOWN}
    for what, command in commands.items():
        with contextlib.suppress(CommandUnconfirmed):
            await wire.command(command, check)
        if (answer := wire.answer(command)) != ACCEPTED:
            return CommandRejected(
                f"the gimbal, {what}: asked {_ATTEMPTS} times ({answer}); is the autopilot set up "
                "as its manager (PX4: MNT_MODE_IN=4, MNT_MODE_OUT), and nobody else in control?"
            )
    return None


async def _what_is_seen(heard: Hearing, timeout_s: float) -> CommandUnconfirmed | None:
    """Wait for an attitude since now that looks down. -> what is seen instead"""
    gimbal, asked_s = heard.telemetry.gimbal, heard.pose.time_s

    def off_deg() -> float:
        newest = gimbal.newest
        if newest is None or newest.time_s <= asked_s:
            return math.nan
        return math.degrees(off_down_rad(camera_to_ned(newest, heading_rad=0.0)))

    with contextlib.suppress(CommandUnconfirmed):
        await heard.wait_until(lambda: off_deg() <= GIMBAL_ERROR_DEG, "the gimbal", timeout_s)
    if gimbal.doubt:
        return CommandUnconfirmed(gimbal.doubt)
    if math.isnan(off_deg()):
        components = ", ".join(map(str, (1, *GIMBAL_COMPONENTS)))
        return CommandUnconfirmed(
            f"no attitude of a gimbal is heard ({' or '.join(GIMBAL_MESSAGES)} of the vehicle's "
            f"components {components}): is it on, and does the autopilot forward it to this link?"
        )
    if off_deg() > GIMBAL_ERROR_DEG:
        return CommandUnconfirmed(
            f"the gimbal was told to look down, and looks {off_deg():.0f} degrees off; "
            f"{GIMBAL_ERROR_DEG:g} are allowed: is it free to move, and nobody else in control?"
        )
    return None
