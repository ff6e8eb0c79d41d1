"""Where the agent may go next: a random roadmap over the arena, and its encoding."""

from dronemon.roadmap.encoding import laplacian_encoding
from dronemon.roadmap.graph import MAX_ADDED_NEIGHBOURS, Roadmap

__all__ = ["MAX_ADDED_NEIGHBOURS", "Roadmap", "laplacian_encoding"]
