"""The simulated world: moving targets, the circular sensor, and the instances made of them."""

from dronemon.world.instance import Instance
from dronemon.world.sensing import Leg, measure, sample_leg, sense
from dronemon.world.targets import TargetPaths

__all__ = ["Instance", "Leg", "TargetPaths", "measure", "sample_leg", "sense"]
