"""Measuring planners: episodes, tables and figures."""

from dronemon.evaluation.episode import Conditions, Episode, fly_episode
from dronemon.evaluation.evaluate import evaluate
from dronemon.evaluation.options import Cell, Options, PlannerSpec
from dronemon.evaluation.results import Result

__all__ = [
    "Cell",
    "Conditions",
    "Episode",
    "Options",
    "PlannerSpec",
    "Result",
    "evaluate",
    "fly_episode",
]
