"""Trained weights and the card that says where they come from, in one file that is safe to open.

Only tensors, numbers and text are read (`weights_only`), and a digest guards the weights.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dronemon.card import CARD_FILE, Card, read_card
from dronemon.errors import CheckpointMismatch
from dronemon.policy.layers import NetworkConfig
from dronemon.policy.network import PolicyNetwork


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """A network that is ready to judge, and its card."""

    network: PolicyNetwork
    card: Card


def save_checkpoint(path: Path, network: PolicyNetwork, card: Card) -> None:
    """Write weights and card, whole or not at all."""
    weights = {name: value.detach().cpu() for name, value in network.state_dict().items()}
    write_atomically(
        path,
        {
            "config": dataclasses.asdict(network.config),
            "weights": weights,
            "digest": digest(weights),
        },
        {CARD_FILE: card.as_json()},
    )


def load_checkpoint(path: Path, expected: NetworkConfig | None = None) -> Checkpoint:
    """Read a checkpoint; the network is in evaluation mode.

    Raises CheckpointMismatch if the file is missing, damaged, or not a network of this kind (or not
    the `expected` one).
    """
    content = read_tensors(path)
    card = read_card(path)
    try:
        config = NetworkConfig(**content["config"])
        weights = content["weights"]
        is_whole = digest(weights) == content["digest"]
    except Exception as exc:  # a file of others may hold anything
        raise CheckpointMismatch(f"{path}: incomplete or from another version: {exc}") from exc
    if expected is not None and config != expected:
        raise CheckpointMismatch(f"{path}: {_difference(config, expected)}")
    if not is_whole:
        raise CheckpointMismatch(f"{path}: damaged, its weights are not those it was written with")
    try:
        network = PolicyNetwork(config)
        network.load_state_dict(weights)
    except Exception as exc:
        raise CheckpointMismatch(f"{path}: weights do not fit its own shape: {exc}") from exc
    return Checkpoint(network=network.eval(), card=card)


def write_atomically(
    path: Path, content: Mapping[str, Any], texts: Mapping[str, str] | None = None
) -> None:
    """Write tensors, numbers and text to a file, whole or not at all, even if power fails.

    texts: files to lie beside them in the archive, by name
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with partial.open("w+b") as file:
            torch.save(dict(content), file)
            with zipfile.ZipFile(file, "a") as archive:
                for name, text in (texts or {}).items():
                    archive.writestr(zipfile.ZipInfo(name), text)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def read_tensors(path: Path) -> dict[str, Any]:
    """Read what `write_atomically` wrote. Raises CheckpointMismatch if that cannot be."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as exc:
        raise CheckpointMismatch(f"{path}: no such file") from exc
    except Exception as exc:  # torch's unpickler may fail in any way on bytes that are not torch's
        reason = str(exc).strip().split("\n")[0]
        raise CheckpointMismatch(f"{path}: not a checkpoint, damaged or unsafe: {reason}") from exc
    if not isinstance(content, dict):
        raise CheckpointMismatch(f"{path}: holds a {type(content).__name__}, not a checkpoint")
    return content


def digest(weights: Mapping[str, Tensor]) -> str:
    """SHA-256 of all weights with their names and shapes."""
    total = hashlib.sha256()
    for name in sorted(weights):
        value = weights[name].detach().cpu().contiguous()
        total.update(f"{name} {tuple(value.shape)} {value.dtype}\n".encode())
        total.update(value.numpy().tobytes())
    return total.hexdigest()


def _difference(found: NetworkConfig, expected: NetworkConfig) -> str:
    """The first setting in which two networks differ."""
    pairs = zip(
        dataclasses.asdict(found).items(), dataclasses.asdict(expected).values(), strict=True
    )
    (name, has), wants = next((item, want) for item, want in pairs if item[1] != want)
    return f"its {name} is {has!r}, not {wants!r} as asked for"
