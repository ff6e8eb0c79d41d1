"""The simulated world: moving targets, the circular sensor, and the instances made of them."""

from dronemon.world.instance import Instance
from dronemon.world.sensing import Roster, measure, misread, num_due, sample_leg, share_at
from dronemon.world.targets import TargetPaths

__all__ = [
    "Instance",
    "Roster",
    "TargetPaths",
    "measure",
    "misread",
    "num_due",
    "sample_leg",
    "share_at",
]
