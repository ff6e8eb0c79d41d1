"""The vehicle: what the mission needs of it, and MAVSDK behind that."""

from dronemon.vehicle.link import (
    AIRBORNE,
    UNFLOWN,
    Landed,
    Mode,
    Setpoint,
    StatusText,
    VehicleLink,
    VehicleState,
)

__all__ = [
    "AIRBORNE",
    "UNFLOWN",
    "Landed",
    "Mode",
    "Setpoint",
    "StatusText",
    "VehicleLink",
    "VehicleState",
]
