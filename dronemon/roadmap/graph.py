"""The random roadmap: nodes over the arena, each joined to its nearest neighbours.

Source: paper, section IV-A.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from dronemon.arena import ARENA, Arena
from dronemon.types import BoolArray, FloatArray, IntArray

MAX_ADDED_NEIGHBOURS = 4
"""Most edges that a node is given besides those to its nearest, of which there is at least one.

Each is the shortest between some nodes and all others, so it belongs to the minimum spanning tree;
edges of that meet at 60 degrees or more, so a node has five at most, and one leads to its nearest.
"""


@dataclass(frozen=True, kw_only=True)
class Roadmap:
    """A directed graph of waypoints; node 0 is where the agent starts.

    nodes_au: (V, 2) au; neighbours: (V, K) int64 nodes joined to each, nearest first: column 0 is
    the node itself, and so is padding.
    """

    nodes_au: FloatArray
    neighbours: IntArray

    @classmethod
    def random(
        cls,
        num_nodes: int,
        num_neighbours: int,
        rng: np.random.Generator,
        start_au: FloatArray,
        arena: Arena = ARENA,
    ) -> Roadmap:
        """Draw `num_nodes` uniform nodes besides the start, each joined to its nearest.

        num_neighbours counts the node itself; start_au: (2,) au.
        """
        drawn_au = arena.sample_free(num_nodes, rng)
        nodes_au = np.concatenate([np.asarray(start_au, dtype=np.float64)[None], drawn_au])
        distance_au = _pairwise(nodes_au)
        np.fill_diagonal(distance_au, -1.0)  # the node itself comes first, whatever else lies there
        nearest = np.argsort(distance_au, axis=1, kind="stable")[:, :num_neighbours]
        return cls(nodes_au=nodes_au, neighbours=_joined(distance_au, nearest))

    @property
    def num_nodes(self) -> int:
        """Nodes, the start among them."""
        return len(self.nodes_au)

    @property
    def is_move(self) -> BoolArray:
        """(V, K) bool: entries of `neighbours` that lead to another node."""
        moves: BoolArray = self.neighbours != np.arange(self.num_nodes)[:, None]
        return moves

    @cached_property
    def edge_lengths_au(self) -> csr_array:
        """(V, V) sparse: length of each edge, from its row's node to its column's."""
        head, column = np.nonzero(self.is_move)
        tail = self.neighbours[head, column]
        length_au = np.linalg.norm(self.nodes_au[head] - self.nodes_au[tail], axis=-1)
        return csr_array((length_au, (head, tail)), shape=(self.num_nodes, self.num_nodes))

    @cached_property
    def _paths(self) -> tuple[FloatArray, IntArray]:
        """Shortest paths to every node, found backwards from it: distances, and next hops."""
        distance_au, towards = dijkstra(self.edge_lengths_au.T.tocsr(), return_predecessors=True)
        next_hop = towards.T.astype(np.int64)
        np.fill_diagonal(next_hop, np.arange(self.num_nodes))
        return np.ascontiguousarray(distance_au.T), np.ascontiguousarray(next_hop)

    @property
    def distance_au(self) -> FloatArray:
        """(V, V) au: shortest path from the row's node to the column's along the edges."""
        return self._paths[0]

    @property
    def next_hop(self) -> IntArray:
        """(V, V): neighbour of the row's node on the shortest path to the column's."""
        return self._paths[1]


def _pairwise(nodes_au: FloatArray) -> FloatArray:
    """Straight distances. nodes_au: (V, 2) -> (V, V) au."""
    difference: FloatArray = nodes_au[:, None] - nodes_au
    return np.hypot(difference[..., 0], difference[..., 1])


def _joined(distance_au: FloatArray, neighbours: IntArray) -> IntArray:
    """Add edges until every node can be reached from every other. (V, V), (V, k) -> (V, K >= k).

    While some nodes cannot, the nearest pair of one strong component and the rest is joined both
    ways. The nodes' other edges stay, so K grows by the most edges that one node was given.
    """
    # Differs from STAMP: its roadmap may hold nodes that no path reaches.
    count = len(neighbours)
    extra: list[list[int]] = [[] for _ in range(count)]
    rows = np.repeat(np.arange(count), neighbours.shape[1])
    edges = csr_array(
        (np.ones(rows.size, dtype=bool), (rows, neighbours.ravel())), shape=(count,) * 2
    ).tolil()
    while True:
        num_components, label = connected_components(edges, connection="strong")
        if num_components == 1:
            break
        inside = label == np.bincount(label).argmin()
        between = np.where(inside[:, None] & ~inside, distance_au, np.inf)
        a, b = np.unravel_index(between.argmin(), between.shape)
        for head, tail in ((a, b), (b, a)):
            if not edges[head, tail]:
                edges[head, tail] = True
                extra[head].append(int(tail))
    widest = max(map(len, extra))
    padding = [more + [node] * (widest - len(more)) for node, more in enumerate(extra)]
    added = np.array(padding, dtype=np.int64).reshape(count, widest)
    return np.concatenate([neighbours, added], axis=1)
