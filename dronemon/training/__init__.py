"""Training of the learned policy: rollouts, PPO, imitation, and runs that can be killed."""

from dronemon.training.train import METRICS, Plan, train

__all__ = ["METRICS", "Plan", "train"]
