"""A small network for the simulator's animals, people and vehicles, and its training."""
