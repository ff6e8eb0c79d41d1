"""The roadmap: who is joined to whom, and the shortest ways."""

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

from dronemon.roadmap import Roadmap
from dronemon.roadmap.graph import _joined, _pairwise


def drawn(seed=10_000, num_nodes=120, num_neighbours=10):
    rng = np.random.default_rng(seed)
    return Roadmap.random(num_nodes, num_neighbours, rng, rng.random(2))


def test_nodes_are_the_start_and_uniform_draws():
    start = np.array([0.25, 0.75])
    roadmap = Roadmap.random(200, 10, np.random.default_rng(0), start)
    assert roadmap.num_nodes == 201
    assert roadmap.nodes_au[0].tolist() == start.tolist()
    assert ((roadmap.nodes_au >= 0) & (roadmap.nodes_au <= 1)).all()


def test_each_node_is_joined_to_its_nearest_itself_first():
    roadmap = drawn()
    for node, neighbours in enumerate(roadmap.neighbours):
        distance = np.linalg.norm(roadmap.nodes_au - roadmap.nodes_au[node], axis=-1)
        assert neighbours[0] == node
        assert neighbours[:10].tolist() == np.argsort(distance)[:10].tolist()
    assert not roadmap.is_move[:, 0].any()
    assert roadmap.is_move[:, 1:10].all()


def test_node_on_another_comes_first_in_its_own_row():
    start = np.random.default_rng(7).uniform(size=(30, 2))[4]
    roadmap = Roadmap.random(30, 5, np.random.default_rng(7), start)
    assert roadmap.nodes_au[5].tolist() == roadmap.nodes_au[0].tolist()
    assert roadmap.neighbours[:, 0].tolist() == list(range(31))


@pytest.mark.parametrize("seed", range(10_000, 10_010))
def test_every_node_reaches_every_other(seed):
    roadmap = drawn(seed, num_nodes=60, num_neighbours=3)
    assert connected_components(roadmap.edge_lengths_au, connection="strong")[0] == 1
    assert np.isfinite(roadmap.distance_au).all()


def test_islands_are_joined_by_their_nearest_pair():
    nodes = np.array([[0.0, 0.0], [0.1, 0.0], [0.9, 1.0], [1.0, 1.0]])
    neighbours = _joined(_pairwise(nodes), np.array([[0, 1], [1, 0], [2, 3], [3, 2]]))
    assert neighbours.tolist() == [[0, 1, 0], [1, 0, 2], [2, 3, 1], [3, 2, 3]]


def test_shortest_paths_follow_edges_and_cannot_be_shortened():
    roadmap = drawn()
    distance, hop = roadmap.distance_au, roadmap.next_hop
    assert (np.diag(distance) == 0).all()
    edges = roadmap.edge_lengths_au.tocoo()
    for head, tail, length in zip(*edges.coords, edges.data, strict=True):
        assert distance[head, tail] == length
    for start, goal in np.random.default_rng(0).integers(0, roadmap.num_nodes, size=(50, 2)):
        node, flown = start, 0.0
        while node != goal:
            following = hop[node, goal]
            assert following in roadmap.neighbours[node]
            flown += np.linalg.norm(roadmap.nodes_au[following] - roadmap.nodes_au[node])
            node = following
        assert flown == pytest.approx(distance[start, goal], abs=1e-12)
    detours = distance[:, :, None] + distance[None]
    assert (distance[:, None] <= detours + 1e-12).all()
    assert (np.diag(hop) == np.arange(roadmap.num_nodes)).all()


def test_same_stream_same_roadmap():
    first, second = drawn(), drawn()
    assert (first.nodes_au == second.nodes_au).all()
    assert (first.neighbours == second.neighbours).all()
