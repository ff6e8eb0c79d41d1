"""The learned policy: features, the paper's network, its memory in flight, checkpoints."""

from dronemon.card import Card, Scope, find_checkpoint
from dronemon.policy.checkpoint import (
    Checkpoint,
    load_checkpoint,
    read_tensors,
    save_checkpoint,
    write_atomically,
)
from dronemon.policy.decoder import Verdict
from dronemon.policy.explanation import Explanation, explain
from dronemon.policy.features import (
    Graphs,
    Segment,
    belief_features,
    frame_points,
)
from dronemon.policy.history import History
from dronemon.policy.layers import NetworkConfig
from dronemon.policy.network import PolicyNetwork
from dronemon.policy.tracks import Tracks

__all__ = [
    "Card",
    "Checkpoint",
    "Explanation",
    "Graphs",
    "History",
    "NetworkConfig",
    "PolicyNetwork",
    "Scope",
    "Segment",
    "Tracks",
    "Verdict",
    "belief_features",
    "explain",
    "find_checkpoint",
    "frame_points",
    "load_checkpoint",
    "read_tensors",
    "save_checkpoint",
    "write_atomically",
]
