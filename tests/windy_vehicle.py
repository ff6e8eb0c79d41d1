"""A vehicle in memory that leans against a steady wind, and pays for it from its battery."""

from __future__ import annotations

import math

from fake_link import STEP_S, FakeVehicle

from dronemon.vehicle import Mode

GRAVITY_M_S2 = 9.80665
_GAIN_PER_S, _POSITION_GAIN_PER_S = 2.0, 0.95


class WindyVehicle(FakeVehicle):
    """Flies with inertia and PX4's parameters; `charge` is its true battery level.

    wind_m_s: (north, east) where the air goes; with its drag and its greatest tilt it flies at most
    12 m/s through the air.
    """

    def __init__(self, wind_m_s: tuple[float, float], charge: float, endurance_s: float) -> None:
        super().__init__()
        self.charge = self.battery = charge
        self._wind_m_s, self._endurance_s = wind_m_s, endurance_s
        self._drag_per_s = GRAVITY_M_S2 / 12.0
        self._moves_m_s = [0.0, 0.0, 0.0]
        self._is_high = False

    def step(self) -> None:
        if self.mode is not Mode.RETURN:
            self._is_high = False
        super().step()
        if self.is_on_ground:
            self._moves_m_s, self.attitude_rad = [0.0, 0.0, 0.0], (0.0, 0.0, 0.0)

    def _fly(self) -> None:
        p, mode, setpoint, height_m = self.parameters, self.mode, self.setpoint, -self.position[2]
        slow, fast = p["MPC_LAND_SPEED"], p["MPC_Z_V_AUTO_DN"]
        high_m, low_m = p["MPC_LAND_ALT1"], p["MPC_LAND_ALT2"]
        share = min(max((height_m - low_m) / (high_m - low_m), 0.0), 1.0)
        sink = slow + share * (fast - slow)
        wanted = [0.0, 0.0, 0.0]
        if mode is Mode.TAKEOFF:
            wanted[2] = -p["MPC_Z_V_AUTO_UP"]
            if height_m >= -self.target_down_m:
                self.intent, wanted[2] = Mode.HOLD, 0.0
        elif mode is Mode.OFFBOARD and setpoint is not None:
            for axis in range(3):
                off_m = setpoint.position_ned_m[axis] - self.position[axis]
                wanted[axis] = setpoint.velocity_ned_m_s[axis] + _POSITION_GAIN_PER_S * off_m
        elif mode is Mode.RETURN:
            self._is_high |= height_m >= p["RTL_RETURN_ALT"]
            away_m = math.hypot(*self.position[:2])
            if not self._is_high:
                wanted[2] = -p["MPC_Z_V_AUTO_UP"]
            elif away_m > 2.0:
                speed = min(p["MPC_XY_CRUISE"], away_m)
                wanted[:2] = [-speed * x / away_m for x in self.position[:2]]
            else:
                wanted[2] = sink
        elif mode is Mode.LAND:
            wanted[2] = sink
        if not (self.is_on_ground and wanted[2] >= 0.0):
            self._move_towards(wanted)

    def _move_towards(self, wanted_m_s: list[float]) -> None:
        moves, most = self._moves_m_s, math.tan(math.radians(self.parameters["MPC_TILTMAX_AIR"]))
        drag = [self._drag_per_s * (moves[axis] - self._wind_m_s[axis]) for axis in (0, 1)]
        push = [_GAIN_PER_S * (wanted_m_s[a] - moves[a]) + drag[a] for a in (0, 1)]
        scale = min(1.0, GRAVITY_M_S2 * most / max(math.hypot(*push), 1e-9))
        push = [scale * p for p in push]
        for axis in (0, 1):
            moves[axis] += (push[axis] - drag[axis]) * STEP_S
        moves[2] = wanted_m_s[2]
        for axis in range(3):
            self.position[axis] += moves[axis] * STEP_S
        self.position[2] = min(self.position[2], 0.0)
        pitch = -math.atan(push[0] / GRAVITY_M_S2)
        roll = math.atan(push[1] / GRAVITY_M_S2 * math.cos(pitch))
        self.attitude_rad = roll, pitch, 0.0
        effort_s = STEP_S * math.hypot(1.0, math.hypot(*push) / GRAVITY_M_S2) ** 1.5
        self.charge = max(self.charge - effort_s / self._endurance_s, 0.0)
        self.battery = math.ceil(100.0 * self.charge) / 100.0
