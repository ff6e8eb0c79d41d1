"""The vehicle: what the mission needs of it, and MAVSDK behind that."""

from dronemon.vehicle.link import Landed, Mode, Setpoint, StatusText, VehicleLink, VehicleState

__all__ = ["Landed", "Mode", "Setpoint", "StatusText", "VehicleLink", "VehicleState"]
