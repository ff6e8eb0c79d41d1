"""Where each target may be: Gaussian processes, what they are conditioned on, and their scores."""

from dronemon.belief.gp import Matern32, Posterior, fit
from dronemon.belief.store import Belief, ObservationStore

__all__ = ["Belief", "Matern32", "ObservationStore", "Posterior", "fit"]
