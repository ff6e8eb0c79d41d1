"""The way home, and the pilot, who always wins."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable
from functools import partial

from dronemon.errors import (
    CommandRejected,
    CommandUnconfirmed,
    ControlTaken,
    DronemonError,
    LinkLost,
    VehicleError,
)
from dronemon.runner.report import Reporter
from dronemon.runner.status import REPORT_INTERVAL_S, FlightStatus, Interrupts
from dronemon.vehicle import Landed, Mode, Setpoint, VehicleLink

LANDING_LIMIT_S = 900.0
"""Vehicle time for the way home and the landing."""
LOST_LINK_LIMIT_S = 120.0
"""Wall time for a lost link to come back; the autopilot flies home by itself meanwhile."""
FAILING_LIMIT_S = 120.0
"""Wall time in which returning and landing are asked for in turn, while both are refused."""
_HEARTBEATS_TO_BE_SURE = 2


class Homecoming:
    """Brings the drone home from wherever it is, unless the pilot flies it.

    status: makes a line of progress for a phase.
    """

    def __init__(
        self,
        link: VehicleLink,
        report: Reporter,
        interrupts: Interrupts,
        status: Callable[[str], FlightStatus],
    ) -> None:
        self._link = link
        self._report = report
        self._interrupts = interrupts
        self._make_status = status
        self.arm_was_asked = False
        self.pilot_flies = False

    async def come_home(self) -> DronemonError | None:
        """Return and land; land here if returning fails or a person wants it. -> what failed."""
        self._report.must_go_on = True
        link, loop = self._link, asyncio.get_running_loop()
        if self.pilot_flies:
            return None
        if self.arm_was_asked and not link.state.is_armed:
            with contextlib.suppress(VehicleError):  # heartbeats are slow: it may have armed since
                for _ in range(_HEARTBEATS_TO_BE_SURE):
                    await link.next_heartbeat()
        was_armed = link.state.is_armed
        give_up_at, lost = loop.time() + LOST_LINK_LIMIT_S, False
        land_here, taken, fail_until = False, None, math.inf
        while link.state.is_armed:
            try:
                if lost:
                    await link.next_heartbeat()  # what was chosen meanwhile counts
                    give_up_at, lost = loop.time() + LOST_LINK_LIMIT_S, False
                if taken is not None and not taken.by_failsafe:
                    if not await self.wait_for_pilot(taken):
                        return None
                elif taken is not None:
                    self._report.note("failsafe", str(taken), level="WARN")
                    link.release()
                    if link.state.mode in {Mode.RETURN, Mode.LAND}:
                        await self._wait_for_landing(land_here, "failsafe lands")
                    else:  # it hovers, as PX4 does without GPS: only down is left
                        land_here = True
                elif link.state.landed is Landed.ON_GROUND:
                    await link.disarm()
                else:
                    land_here = land_here or self._interrupts.land_now
                    await self._go(land_here)
                taken = None
            except ControlTaken as exc:
                taken = exc
            except LinkLost as exc:
                if not lost:
                    self._report.note("link lost", str(exc), level="ERROR")
                lost = True
                if self.pilot_flies or loop.time() > give_up_at:
                    return exc
            except (CommandRejected, CommandUnconfirmed) as exc:
                if math.isinf(fail_until):
                    fail_until = loop.time() + FAILING_LIMIT_S
                    self._report.note("failure", str(exc), level="ERROR")
                if loop.time() > fail_until:
                    return exc
                land_here = not land_here  # what is refused now, without GPS say, may go later
            except VehicleError as exc:
                self._report.note("failure", str(exc), level="ERROR")
                return exc
        if was_armed:
            self._report.note("disarmed", "the motors are off")
        return None

    async def _go(self, land_here: bool) -> None:
        if land_here:
            await self._link.land()
        else:
            await self._link.return_home()
        phase = "landing here" if land_here else "returning"
        self._report.note("homecoming", phase)
        await self._wait_for_landing(land_here, phase)

    async def _wait_for_landing(self, land_here: bool, phase: str) -> None:
        """Wait until disarmed, or until a person wants to land here instead of at home."""
        end_s = self._link.time_s + LANDING_LIMIT_S
        while not self._is_down(land_here):
            self._report.progress(self._make_status(phase))
            now_s = self._link.time_s
            await self._link.wait_until(
                partial(self._is_down, land_here, now_s + REPORT_INTERVAL_S),
                "landing and disarming",
                end_s - now_s,
            )

    def _is_down(self, land_here: bool, until_s: float = math.inf) -> bool:
        """Whether to wait no longer: disarmed, another way down wanted, or time to say so."""
        change = self._interrupts.land_now and not land_here
        return not self._link.state.is_armed or change or self._link.time_s >= until_s

    async def wait_for_pilot(self, taken: ControlTaken) -> bool:
        """Wait while the pilot flies: True once the mode is offboard again, else False.

        It ends when the vehicle is disarmed, or a person asks twice to end the program. A setpoint
        for the present place flows meanwhile, since PX4 lets the pilot choose offboard only then;
        it does not flow during a failsafe, which it would end.
        Raises LinkLost when the link stays lost, and nothing is commanded then.
        """
        self.pilot_flies = self._report.must_go_on = True
        self._report.note("control taken", str(taken), level="WARN")
        link, loop = self._link, asyncio.get_running_loop()
        link.release()
        heard_at = loop.time()
        while link.state.is_armed and not self._interrupts.land_now:
            try:
                if await self._offer_control():
                    self.pilot_flies = self._report.must_go_on = False
                    self._report.note("control given back", "the mode is offboard again")
                    return True
                heard_at = loop.time()
            except LinkLost:
                if loop.time() > heard_at + LOST_LINK_LIMIT_S:
                    raise
        return False

    async def _offer_control(self) -> bool:
        """Send a setpoint for the present place. -> whether the pilot has chosen offboard."""
        link = self._link
        pose = await link.next_pose()
        if link.state.is_armed and link.state.mode is Mode.OFFBOARD:
            return True
        self._report.progress(self._make_status("the pilot flies"))
        if not link.state.is_failsafe:
            await link.send_setpoint(
                Setpoint(
                    position_ned_m=pose.position_ned_m,
                    velocity_ned_m_s=(0.0, 0.0, 0.0),
                    yaw_rad=pose.attitude_rad[2],
                )
            )
        return False
