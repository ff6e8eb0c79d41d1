"""Where each target may be: Gaussian processes, what they are conditioned on, and their scores."""

from dronemon.belief.gp import Posterior, fit
from dronemon.belief.kernel import Matern32
from dronemon.belief.metrics import EpisodeMetrics, Scores, episode_metrics
from dronemon.belief.store import Belief, ObservationStore

__all__ = [
    "Belief",
    "EpisodeMetrics",
    "Matern32",
    "ObservationStore",
    "Posterior",
    "Scores",
    "episode_metrics",
    "fit",
]
