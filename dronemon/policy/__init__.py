"""The learned policy: features, the paper's network, its memory in flight, checkpoints."""

from dronemon.card import Card, Scope, find_checkpoint
from dronemon.policy.checkpoint import (
    DEFAULT_HISTORY,
    Checkpoint,
    load_checkpoint,
    read_tensors,
    save_checkpoint,
    write_atomically,
)
from dronemon.policy.decoder import Verdict
from dronemon.policy.encoders import TemporalEncoder
from dronemon.policy.features import (
    Graphs,
    Segment,
    belief_features,
    num_windows,
    pool_windows,
)
from dronemon.policy.history import History
from dronemon.policy.layers import NetworkConfig, Projections
from dronemon.policy.network import PolicyNetwork
from dronemon.policy.tracks import NUM_TRACK_FEATURES, Tracks

__all__ = [
    "DEFAULT_HISTORY",
    "NUM_TRACK_FEATURES",
    "Card",
    "Checkpoint",
    "Graphs",
    "History",
    "NetworkConfig",
    "PolicyNetwork",
    "Projections",
    "Scope",
    "Segment",
    "TemporalEncoder",
    "Tracks",
    "Verdict",
    "belief_features",
    "find_checkpoint",
    "load_checkpoint",
    "num_windows",
    "pool_windows",
    "read_tensors",
    "save_checkpoint",
    "write_atomically",
]
