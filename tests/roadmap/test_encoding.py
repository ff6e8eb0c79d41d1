"""The Laplacian encoding: eigenvectors of the right matrix, with settled signs."""

import numpy as np

from dronemon.roadmap import Roadmap, laplacian_encoding


def drawn(num_nodes):
    rng = np.random.default_rng(10_000)
    return Roadmap.random(num_nodes, 10, rng, rng.random(2))


def test_columns_are_eigenvectors_of_the_symmetric_normalised_laplacian():
    roadmap = drawn(100)
    adjacency = np.zeros((101, 101))
    for node, neighbours in enumerate(roadmap.neighbours):
        adjacency[node, neighbours] = adjacency[neighbours, node] = 1.0
    np.fill_diagonal(adjacency, 0.0)
    scale = np.diag(adjacency.sum(axis=1) ** -0.5)
    laplacian = np.eye(101) - scale @ adjacency @ scale
    encoding = laplacian_encoding(roadmap)
    assert encoding.shape == (101, 32)
    np.testing.assert_allclose(encoding.T @ encoding, np.eye(32), atol=1e-10)
    values = np.diag(encoding.T @ laplacian @ encoding)
    np.testing.assert_allclose(laplacian @ encoding, encoding * values, atol=1e-10)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(laplacian)[1:33], atol=1e-10)
    assert values[0] > 1e-6, "the constant eigenvector says nothing"


def test_signs_are_settled():
    encoding = laplacian_encoding(drawn(100))
    peak = np.abs(encoding).argmax(axis=0)
    assert (encoding[peak, np.arange(32)] > 0).all()


def test_small_roadmaps_are_padded():
    encoding = laplacian_encoding(drawn(12))
    assert encoding.shape == (13, 32)
    assert (encoding[:, 12:] == 0).all()
    assert (np.abs(encoding[:, :12]).sum(axis=0) > 0).all()
