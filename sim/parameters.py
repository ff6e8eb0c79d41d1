"""The autopilot's parameters: PX4's names, types and defaults, for those that have an effect here.

The defaults were measured to act in PX4 v1.17 SITL, such as a return altitude of 30 m.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

_INT32: int = mavlink.MAV_PARAM_TYPE_INT32
_REAL32: int = mavlink.MAV_PARAM_TYPE_REAL32


class Parameter(NamedTuple):
    """One parameter: its default, which also gives its type, and the values that make sense."""

    name: str
    default: float | int
    low: float
    high: float


TABLE = (
    Parameter("BAT1_N_CELLS", 4, 1, 16),
    Parameter("BAT_CRIT_THR", 0.07, 0.05, 0.5),
    Parameter("BAT_EMERGEN_THR", 0.05, 0.03, 0.5),
    Parameter("BAT_LOW_THR", 0.15, 0.12, 0.5),
    Parameter("COM_ARM_WO_GPS", 1, 0, 2),
    Parameter("COM_DISARM_LAND", 2.0, -1.0, 20.0),
    Parameter("COM_DISARM_PRFLT", 10.0, -1.0, 3600.0),
    Parameter("COM_FAIL_ACT_T", 5.0, 0.0, 25.0),
    Parameter("COM_LOW_BAT_ACT", 3, 0, 3),
    Parameter("COM_OBL_RC_ACT", 0, 0, 7),
    Parameter("COM_OF_LOSS_T", 1.0, 0.0, 60.0),
    Parameter("COM_RCL_EXCEPT", 0, 0, 31),
    Parameter("COM_RC_IN_MODE", 3, 0, 8),
    Parameter("COM_RC_OVERRIDE", 1, 0, 3),
    Parameter("COM_SPOOLUP_TIME", 1.0, 0.0, 30.0),
    Parameter("GF_ACTION", 2, 0, 5),
    Parameter("GF_MAX_HOR_DIST", 0.0, 0.0, 10000.0),
    Parameter("GF_MAX_VER_DIST", 0.0, 0.0, 10000.0),
    Parameter("MAV_SYS_ID", 1, 1, 250),
    Parameter("MIS_TAKEOFF_ALT", 2.5, 0.0, 1000.0),
    Parameter("MPC_ACC_DOWN_MAX", 3.0, 2.0, 15.0),
    Parameter("MPC_ACC_HOR", 3.0, 2.0, 15.0),
    Parameter("MPC_ACC_UP_MAX", 4.0, 2.0, 15.0),
    Parameter("MPC_JERK_AUTO", 4.0, 1.0, 80.0),
    Parameter("MPC_LAND_ALT1", 10.0, 0.0, 100.0),
    Parameter("MPC_LAND_ALT2", 5.0, 0.0, 100.0),
    Parameter("MPC_LAND_SPEED", 0.7, 0.6, 10.0),
    Parameter("MPC_TILTMAX_AIR", 45.0, 20.0, 89.0),
    Parameter("MPC_TKO_RAMP_T", 3.0, 0.0, 10.0),
    Parameter("MPC_TKO_SPEED", 1.5, 1.0, 5.0),
    Parameter("MPC_XY_CRUISE", 5.0, 3.0, 20.0),
    Parameter("MPC_XY_P", 0.95, 0.0, 2.0),
    Parameter("MPC_XY_VEL_D_ACC", 0.2, 0.0, 2.0),
    Parameter("MPC_XY_VEL_I_ACC", 0.4, 0.0, 60.0),
    Parameter("MPC_XY_VEL_MAX", 12.0, 0.0, 20.0),
    Parameter("MPC_XY_VEL_P_ACC", 1.8, 1.2, 5.0),
    Parameter("MPC_YAWRAUTO_MAX", 60.0, 5.0, 360.0),
    Parameter("MPC_Z_P", 1.0, 0.0, 1.5),
    Parameter("MPC_Z_VEL_I_ACC", 2.0, 0.2, 3.0),
    Parameter("MPC_Z_VEL_MAX_DN", 1.5, 0.5, 4.0),
    Parameter("MPC_Z_VEL_MAX_UP", 3.0, 0.5, 8.0),
    Parameter("MPC_Z_VEL_P_ACC", 4.0, 2.0, 15.0),
    Parameter("MPC_Z_V_AUTO_DN", 1.5, 0.5, 4.0),
    Parameter("MPC_Z_V_AUTO_UP", 3.0, 0.5, 8.0),
    Parameter("NAV_ACC_RAD", 2.0, 0.05, 200.0),
    Parameter("NAV_DLL_ACT", 0, 0, 6),
    Parameter("NAV_MC_ALT_RAD", 0.8, 0.05, 200.0),
    Parameter("NAV_RCL_ACT", 2, 1, 6),
    Parameter("RTL_CONE_ANG", 45, 0, 90),
    Parameter("RTL_DESCEND_ALT", 10.0, 0.0, 1000.0),
    Parameter("RTL_LAND_DELAY", 0.0, -1.0, 3600.0),
    Parameter("RTL_MIN_DIST", 10.0, 0.5, 100.0),
    Parameter("RTL_RETURN_ALT", 30.0, 0.0, 1000.0),
    Parameter("RTL_TYPE", 0, 0, 5),
    Parameter("SYS_AUTOSTART", 10040, 0, 9_999_999),
)
_BY_NAME = {parameter.name: parameter for parameter in TABLE}
INDEX = {parameter.name: index for index, parameter in enumerate(TABLE)}


class Parameters:
    """The values of all parameters; they outlive a reboot."""

    def __init__(self) -> None:
        self._values: dict[str, float | int] = {p.name: p.default for p in TABLE}

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def set(self, name: str, value: float) -> None:
        """Store a value, kept within the parameter's bounds and of its type."""
        parameter = _BY_NAME[name]
        bounded = min(max(value, parameter.low), parameter.high)
        self._values[name] = round(bounded) if isinstance(parameter.default, int) else bounded

    def on_wire(self, index: int) -> tuple[str, float, int]:
        """Name, value and MAVLink type as PARAM_VALUE carries them: an int32's bytes as a float."""
        name = TABLE[index].name
        value = self._values[name]
        if isinstance(TABLE[index].default, int):
            return name, struct.unpack("<f", struct.pack("<i", int(value)))[0], _INT32
        return name, float(value), _REAL32

    def from_wire(self, name: str, value: float, wire_type: int) -> bool:
        """Store what PARAM_SET carries. -> whether it could: of the right type and finite."""
        is_int = isinstance(_BY_NAME[name].default, int)
        if wire_type != (_INT32 if is_int else _REAL32):
            return False
        if is_int:
            value = struct.unpack("<i", struct.pack("<f", value))[0]
        elif not math.isfinite(value):
            return False
        self.set(name, value)
        return True
