"""Where the agent may go next: a random roadmap over the arena, and its encoding."""

from dronemon.roadmap.encoding import laplacian_encoding
from dronemon.roadmap.graph import Roadmap

__all__ = ["Roadmap", "laplacian_encoding"]
