"""The learning environment as Gymnasium has them: importing this registers the environment's name.

    gymnasium.make("dronemon/Monitoring-v0")                     # one episode at a time
    gymnasium.make_vec("dronemon/Monitoring-v0", num_envs=32)    # many in step

What is observed, done and earned, with shapes and units: docs/laboratory.md.
"""

from dronemon.gym.episodes import Episodes
from dronemon.gym.monitoring import Monitoring, MonitoringVector
from dronemon.gym.observer import Observer

__all__ = ["Episodes", "Monitoring", "MonitoringVector", "Observer"]
