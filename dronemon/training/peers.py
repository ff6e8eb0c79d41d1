"""Processes that train one network together, as started by torchrun; usually only this one."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import nn

from dronemon.errors import OptionError


@dataclass(frozen=True, slots=True, kw_only=True)
class Peers:
    """One process among those that train together."""

    device: torch.device
    rank: int = 0
    size: int = 1

    @property
    def is_first(self) -> bool:
        """Whether this process writes files and talks."""
        return self.rank == 0

    def average_gradients(self, network: nn.Module) -> None:
        """Give every process the mean of all gradients."""
        if self.size == 1:
            return
        gradients = [p.grad for p in network.parameters() if p.grad is not None]
        flat = torch.cat([g.flatten() for g in gradients])
        dist.all_reduce(flat)
        flat /= self.size
        means = torch.split_with_sizes(flat, [g.numel() for g in gradients])
        for gradient, mean in zip(gradients, means, strict=True):
            gradient.copy_(mean.view_as(gradient))

    def share_weights(self, network: nn.Module) -> None:
        """Give every process the first one's weights."""
        if self.size > 1:
            for value in network.state_dict().values():
                dist.broadcast(value, src=0)

    def agree(self, metrics: Mapping[str, float]) -> dict[str, float]:
        """The mean of all processes' numbers, which have the same names."""
        if self.size == 1:
            return dict(metrics)
        values = torch.tensor(list(metrics.values()), dtype=torch.float64, device=self.device)
        dist.all_reduce(values)
        return dict(zip(metrics, (values / self.size).tolist(), strict=True))


@contextmanager
def join_peers(device_name: str) -> Iterator[Peers]:
    """The processes that torchrun started, or this one alone, each on its own device."""
    device = own_device(device_name)
    size = int(os.environ.get("WORLD_SIZE", "1"))
    if size == 1:
        yield Peers(device=device)
        return
    if device.type == "cuda":
        torch.cuda.set_device(device)
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Peers(device=device, rank=dist.get_rank(), size=size)
    finally:
        dist.destroy_process_group()


def own_device(name: str) -> torch.device:
    """The device of this process: `auto` is its own GPU if there is one, else the CPU.

    Raises OptionError if there is no such device.
    """
    has_cuda = torch.cuda.is_available()
    if name == "auto":
        name = "cuda" if has_cuda else "cpu"
    if name == "cuda" and has_cuda:
        return torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
    if name != "cpu":
        raise OptionError(f"--device {name}: there is none; give auto, cpu or cuda")
    return torch.device(name)
