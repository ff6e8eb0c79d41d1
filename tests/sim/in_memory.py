"""The simulated autopilot without a link: stepped by the test itself."""

from __future__ import annotations

from typing import Any

from ground_station import make_mission

from sim.autopilot import Autopilot
from sim.control import TrajectorySetpoint
from sim.flight import HOME_NED_M, MockFlight
from sim.modes import Px4Mode
from sim.world import World


def ready_vehicle(**sections: Any) -> Autopilot:
    """A vehicle just ready to arm, in a mission of these sections."""
    mission = make_mission(**sections)
    autopilot = MockFlight(mission, World(mission)).autopilot
    fly(autopilot, 6.0)
    return autopilot


def fly(autopilot: Autopilot, seconds: float, offboard: TrajectorySetpoint | None = None) -> None:
    """Let time pass; with a setpoint that comes at 10 Hz."""
    for step in range(round(seconds * 100)):
        if offboard is not None and step % 10 == 0:
            autopilot.take_offboard(offboard)
        autopilot.step()


def take_off(autopilot: Autopilot, height_m: float) -> None:
    autopilot.parameters.set("MIS_TAKEOFF_ALT", height_m)
    assert autopilot.arm()
    assert autopilot.request_mode(Px4Mode.TAKEOFF)
    fly(autopilot, 8.0 + height_m / 1.4)


def fly_offboard(autopilot: Autopilot, north_m_s: float = 0.0) -> TrajectorySetpoint:
    """Be in OFFBOARD. -> the setpoint that keeps it there: hover, or fly north."""
    setpoint = hover(autopilot)
    if north_m_s:
        setpoint = TrajectorySetpoint(velocity=(north_m_s, 0.0, 0.0))
    fly(autopilot, 0.5, setpoint)
    assert autopilot.request_mode(Px4Mode.OFFBOARD)
    fly(autopilot, 0.5, setpoint)
    return setpoint


def height_m(autopilot: Autopilot) -> float:
    return HOME_NED_M[2] - autopilot.body.position[2]


def hover(autopilot: Autopilot) -> TrajectorySetpoint:
    north, east, down = autopilot.estimate.position
    return TrajectorySetpoint(position=(north, east, down), yaw_rad=0.0)


def said(autopilot: Autopilot) -> list[str]:
    """Texts since the last call, without the tab that PX4 ends them with."""
    texts = [text.rstrip("\t") for _, text in autopilot.texts]
    autopilot.texts.clear()
    return texts
