"""Training of the learned policy: rollouts, PPO, imitation, and runs that can be killed."""
