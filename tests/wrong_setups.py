"""Sets a vehicle up wrongly in one way after the other, and sees that each is refused.

    python tests/wrong_setups.py URL        # of a vehicle, such as PX4's simulation

Both the mock and a real PX4 are asked so. Each parameter is put back.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import numpy as np

from dronemon.events import Audience
from dronemon.mission import load_mission
from dronemon.preflight import PARAMETERS, Sight
from dronemon.runner.inspection import find, refusal
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.preparation import FlightSetup
from dronemon.vehicle import VehicleLink
from dronemon.vehicle.mavsdk_link import MavsdkLink

MISSION = Path(__file__).parents[1] / "missions" / "animals.yaml"
WRONG = (
    ({"COM_OBL_RC_ACT": 7}, "COM_OBL_RC_ACT=3"),
    ({"COM_OF_LOSS_T": 30.0}, "COM_OF_LOSS_T=1"),
    ({"NAV_RCL_ACT": 6}, "NAV_RCL_ACT=2"),
    ({"NAV_RCL_ACT": 1, "COM_LOW_BAT_ACT": 0}, "COM_OBL_RC_ACT=3"),
    ({"NAV_DLL_ACT": 5}, "NAV_DLL_ACT=0"),
    ({"NAV_DLL_ACT": 0, "COM_LOW_BAT_ACT": 0}, "COM_LOW_BAT_ACT=3"),
    ({"RTL_RETURN_ALT": 900.0}, "RTL_RETURN_ALT=45"),
    ({"RTL_LAND_DELAY": -1.0}, "RTL_LAND_DELAY=0"),
    ({"GF_ACTION": 0}, "GF_ACTION=3"),
    ({"GF_ACTION": 4}, "GF_ACTION=3"),
    ({"GF_MAX_HOR_DIST": 50.0}, "GF_MAX_HOR_DIST=170"),
    ({"GF_MAX_VER_DIST": 20.0}, "GF_MAX_VER_DIST=54"),
    ({"BAT_CRIT_THR": 0.4}, "BAT_CRIT_THR=0.07"),
    ({"BAT_EMERGEN_THR": 0.4}, "BAT_EMERGEN_THR=0.05"),
    ({"COM_DISARM_PRFLT": 1.0}, "COM_DISARM_PRFLT=10"),
    ({"COM_FAIL_ACT_T": 20.0}, "COM_FAIL_ACT_T=5"),
)
"""What is set, and the option that mends it."""


async def ask(link: VehicleLink) -> str:
    """Why a flight must not begin, empty if it may; the camera counts as good."""
    nothing = np.full((4, 2), np.nan)
    setup = FlightSetup(
        file=load_mission(MISSION),
        link=link,
        camera=None,
        detector=None,
        planner=None,
        priors_au=nothing,
        record=None,
        audience=Audience(),
        interrupts=Interrupts(),
    )
    findings = await find(setup, Sight(wait_s=0.1, age_s=0.1), frame=None)
    return str(refusal(findings) or "")


async def refused(url: str) -> list[str]:
    """What went otherwise than it should."""
    wrong = []
    async with MavsdkLink(url) as link:
        await link.wait_ready(60.0)
        asked_at = asyncio.get_running_loop().time()
        if answer := await ask(link):
            wrong.append(f"as it is: {answer}")
        wrong += [f"asking took {took_s:.1f} s" for took_s in [_since(asked_at)] if took_s > 1.0]
        before = await link.read_parameters(PARAMETERS)
        wrong += [f"it has no {name}" for name in PARAMETERS if name not in before]
        for settings, mend in WRONG:
            for name, value in settings.items():
                await link.write_parameter(name, value)
            answer = await ask(link)
            if f"--set {mend}" not in answer:
                wrong.append(f"{settings}: {answer or 'go'}")
            for name in settings:
                await link.write_parameter(name, before[name])
        if answer := await ask(link):
            wrong.append(f"in the end: {answer}")
    return wrong


def _since(start: float) -> float:
    return asyncio.get_running_loop().time() - start


if __name__ == "__main__":
    sys.exit("\n".join(asyncio.run(refused(sys.argv[1]))) or 0)
