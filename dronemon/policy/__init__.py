"""The learned policy: features, the paper's network, its memory in flight, checkpoints."""

from dronemon.policy.features import (
    LENGTH_SCALE_AU,
    Graphs,
    Segment,
    belief_features,
    num_windows,
    pool_windows,
)
from dronemon.policy.history import History
from dronemon.policy.network import (
    NetworkConfig,
    PolicyNetwork,
    Projections,
    TemporalEncoder,
    Verdict,
)

__all__ = [
    "LENGTH_SCALE_AU",
    "Graphs",
    "History",
    "NetworkConfig",
    "PolicyNetwork",
    "Projections",
    "Segment",
    "TemporalEncoder",
    "Verdict",
    "belief_features",
    "num_windows",
    "pool_windows",
]
