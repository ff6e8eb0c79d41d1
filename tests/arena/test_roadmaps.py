"""Roadmaps in fields of any form."""

from __future__ import annotations

import numpy as np
import pytest
from test_polygons import U, drawn_arena

from dronemon.arena import ARENA, Arena
from dronemon.roadmap import Roadmap
from dronemon.roadmap.graph import _joined, _pairwise


def in_field(arena, seed=10_000, num_nodes=80, num_neighbours=8):
    rng = np.random.default_rng(seed)
    start = arena.sample_free(1, rng)[0]
    return Roadmap.random(num_nodes, num_neighbours, rng, start, arena)


@pytest.mark.parametrize("seed", range(20))
def test_in_a_polygon_edges_are_free_and_lead_everywhere(seed):
    arena = drawn_arena(seed)
    for num_nodes in (3, 80):
        roadmap = in_field(arena, 10_000 + seed, num_nodes)
        assert arena.free.contains(roadmap.nodes_au).all()
        head, tail = roadmap.edge_lengths_au.nonzero()
        assert all(map(arena.segment_is_free, roadmap.nodes_au[head], roadmap.nodes_au[tail]))
        assert np.isfinite(roadmap.distance_au).all()
        assert len(np.unique(roadmap.nodes_au, axis=0)) == roadmap.num_nodes


def test_each_node_is_joined_to_its_nearest_that_it_sees():
    roadmap = in_field(U)
    for node, neighbours in enumerate(roadmap.neighbours):
        seen = [
            n
            for n, at in enumerate(roadmap.nodes_au)
            if U.segment_is_free(roadmap.nodes_au[node], at)
        ]
        distance = np.linalg.norm(roadmap.nodes_au[seen] - roadmap.nodes_au[node], axis=-1)
        nearest = np.array(seen)[np.argsort(distance)][:8]
        assert neighbours[: len(nearest)].tolist() == nearest.tolist()


def test_nodes_are_added_where_a_way_turns_and_only_where_needed():
    assert in_field(U, num_nodes=300).num_nodes == 301
    rng = np.random.default_rng(0)
    ends = np.array([[0.15, 0.9], [0.85, 0.9]])

    class Ends(Arena):
        """Draws the other end."""

        def sample_free(self, count, rng):
            return ends[1:]

    arena = Ends(**{name: getattr(U, name) for name in U.__dataclass_fields__})
    roadmap = Roadmap.random(1, 3, rng, ends[0], arena)
    np.testing.assert_array_equal(roadmap.nodes_au[2:], U.way(*ends)[:-1])
    assert roadmap.distance_au[0, 1] == pytest.approx(2 * np.hypot(0.15, 0.6) + 0.4, abs=1e-3)


def test_a_start_where_one_may_not_be_is_refused():
    with pytest.raises(ValueError, match="may not be at"):
        Roadmap.random(5, 3, np.random.default_rng(0), np.array([0.5, 0.9]), U)


def test_a_polygon_with_nothing_in_the_way_is_joined_as_the_square_is():
    square = Arena.polygon(ARENA.outline_au[:-1])
    roadmap = in_field(square)
    distance = _pairwise(roadmap.nodes_au)
    np.fill_diagonal(distance, -1.0)
    expected = _joined(distance, np.argsort(distance, axis=1, kind="stable")[:, :8])
    assert roadmap.neighbours.tolist() == expected.tolist()
