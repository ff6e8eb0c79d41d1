"""The random roadmap: nodes over the arena, each joined to its nearest by straight free edges.

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
This holds in a rectangle; where something is in the way there may be more.
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

        In a polygon edges keep to where the agent may be. Where no such edges join all nodes, nodes
        are added at the turns of the shortest way from one part to the next, so there may be more
        than were asked for, the drawn ones first.

        num_neighbours counts the node itself; start_au: (2,) au. ValueError where the agent may not
        be there.
        """
        drawn_au = arena.sample_free(num_nodes, rng)
        nodes_au = np.concatenate([np.asarray(start_au, dtype=np.float64)[None], drawn_au])
        nodes_au, distance_au = _bridged(nodes_au, arena)
        np.fill_diagonal(distance_au, -1.0)  # the node itself comes first, whatever else lies there
        nearest = np.argsort(distance_au, axis=1, kind="stable")[:, :num_neighbours]
        is_edge = np.take_along_axis(distance_au, nearest, axis=1) < np.inf
        neighbours = np.where(is_edge, nearest, np.arange(len(nodes_au))[:, None])
        return cls(nodes_au=nodes_au, neighbours=_joined(distance_au, neighbours))

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


def _bridged(nodes_au: FloatArray, arena: Arena) -> tuple[FloatArray, FloatArray]:
    """Add nodes until straight free edges can join all of them, and tell how long each would be.

    nodes_au: (V, 2), the first the start
    -> (W >= V, 2) au; (W, W) au, infinite where something is in the way
    """
    if arena.is_rectangle:
        return nodes_au, _pairwise(nodes_au)
    if not arena.free.contains(nodes_au[0]):
        raise ValueError(f"the agent may not be at {nodes_au[0]} au, where it is to start")
    while True:
        distance_au = _pairwise(nodes_au)
        is_free = _sights(nodes_au, arena)
        _, label = connected_components(is_free)
        is_near = label == label[0]
        if is_near.all():
            return nodes_au, np.where(is_free, distance_au, np.inf)
        between = np.where(is_near[:, None] & ~is_near, distance_au, np.inf)
        near, far = np.unravel_index(between.argmin(), between.shape)
        turns_au = arena.way(nodes_au[near], nodes_au[far])[:-1]
        is_new = (turns_au[:, None] != nodes_au).any(axis=-1).all(axis=-1)
        nodes_au = np.concatenate([nodes_au, turns_au[is_new]])


def _sights(nodes_au: FloatArray, arena: Arena) -> BoolArray:
    """Between which nodes one can fly straight. (V, 2) -> (V, V)."""
    is_free = np.eye(len(nodes_au), dtype=bool)
    one, other = np.triu_indices(len(nodes_au), 1)
    is_free[one, other] = is_free[other, one] = arena.free.is_free(nodes_au[one], nodes_au[other])
    return is_free


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
