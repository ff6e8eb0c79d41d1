"""Why the network decides as it does: the weights of all its attention at one decision.

    V nodes   N targets known   H heads   k neighbours that may be chosen   T' windows seen

Nothing is computed anew: the weights are those by which the decision was made, caught where the
network's softmax gives them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from functools import partial

import torch
from torch import Tensor, nn

from dronemon.policy.decoder import Verdict
from dronemon.policy.encoders import TemporalEncoder
from dronemon.policy.features import Graphs
from dronemon.policy.history import History
from dronemon.policy.network import PolicyNetwork
from dronemon.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Explanation:
    """The weights behind one decision; along its last axis, each array of them sums to 1.

    nodes:    (1 + k,)       int64 the agent's node, then the neighbours in the roadmap's order
    ages_au:  (T',)          au flown since each window of the past, oldest first
    target:   (V, H, N)      target encoder: whom each node's place looks at, in the newest window
    temporal: (V, H, T')     temporal encoder: which window of its own past each node looks at
    spatial:  (H, 1 + k, V)  spatial encoder: which places each of `nodes` looks at
    targets:  (H, N, N)      track encoder: which targets' tracks each target's looks at
    tracks:   (H, 1 + k, N)  track encoder: whose track each of `nodes` looks at
    decoder:  (H, k)         decoder: which neighbours the agent's node looks at
    pointer:  (k,)           the policy: probability of each neighbour, of which the first of the
                             greatest is chosen in flight

    While nothing is known of any target, N is 1: an imagined one. None: the network has none;
    `ages_au` and `temporal` with an LSTM in place of the temporal encoder, `targets` and `tracks`
    without tracks.
    """

    nodes: IntArray
    ages_au: FloatArray | None = None
    target: FloatArray
    temporal: FloatArray | None = None
    spatial: FloatArray
    targets: FloatArray | None = None
    tracks: FloatArray | None = None
    decoder: FloatArray
    pointer: FloatArray

    def arrays(self) -> dict[str, FloatArray | IntArray]:
        """All that there are, by name."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: array for name, array in named.items() if array is not None}


def explain(
    memory: History,
    frame: Tensor,
    target_mask: Tensor,
    length_au: Tensor,
    current: Tensor,
    tracks: Tensor,
) -> tuple[Verdict, Callable[[], list[Explanation]]]:
    """Decide as `History.decide`, whose arguments these are.

    -> the verdict, and a function that gives each episode's weights until the next decision
    """
    with _listening(memory.network) as heard:
        verdict = memory.decide(frame, target_mask, length_au, current, tracks)

    def explanations() -> list[Explanation]:
        weights = heard | {"pointer": verdict.logits.softmax(-1)}
        if "temporal" in heard:
            slots, marks_au = memory.windows()
            weights["temporal"] = heard["temporal"][..., slots]
            weights["ages_au"] = length_au[:, None] - marks_au
        nodes = enumerate(current.tolist())
        return [_of_episode(memory.graphs, b, n, target_mask[b], weights) for b, n in nodes]

    return verdict, explanations


@contextlib.contextmanager
def _listening(network: PolicyNetwork) -> Iterator[dict[str, Tensor]]:
    """What the network's softmaxes give while the body runs, by `Explanation`'s names."""
    heard: dict[str, Tensor] = {}
    places: dict[str, nn.Module] = {
        "target": network.target_encoder.attention.softmax,
        "spatial": network.spatial_encoder.attention.softmax,
        "decoder": network.decoder.attention.softmax,
    }
    if isinstance(network.temporal, TemporalEncoder):
        places["temporal"] = network.temporal.attention.softmax
    if network.track_encoder is not None:
        places["targets"] = network.track_encoder.attention.softmax
        places["tracks"] = network.track_encoder.softmax

    def hear(name: str, _module: nn.Module, _scores: object, weights: Tensor) -> None:
        heard[name] = weights

    with contextlib.ExitStack() as stack:
        for name, module in places.items():
            stack.enter_context(module.register_forward_hook(partial(hear, name)))
        yield heard


def _of_episode(
    graphs: Graphs, episode: int, node: int, known: Tensor, heard: Mapping[str, Tensor]
) -> Explanation:
    """One episode's part of what was heard, without padding. known: (N,) bool."""
    own = {name: every[episode] for name, every in heard.items()}
    there, allowed = graphs.node_mask[episode], graphs.neighbour_mask[episode, node]
    asking = torch.cat([allowed.new_ones(1), allowed])
    neighbours = graphs.neighbours[episode, node, allowed]
    kept = {
        "target": own["target"][0, there, :, 0][..., known],
        "spatial": own["spatial"][0][:, asking][..., there],
        "decoder": own["decoder"][0, :, 0, allowed],
        "pointer": own["pointer"][0, allowed],
    }
    if "temporal" in own:
        kept |= {"ages_au": own["ages_au"], "temporal": own["temporal"][0, there, :, 0]}
    if "tracks" in own:
        kept["targets"] = own["targets"][0][:, known][..., known]
        kept["tracks"] = own["tracks"][0, asking][:, known].permute(2, 0, 1)
    nodes = torch.cat([neighbours.new_tensor([node]), neighbours]).cpu().numpy()
    return Explanation(nodes=nodes, **{k: v.double().cpu().numpy() for k, v in kept.items()})
