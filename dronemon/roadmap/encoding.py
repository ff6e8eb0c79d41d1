"""Positional encoding of a roadmap: eigenvectors of its Laplacian.

Source: paper, section IV-B.3, after Dwivedi & Bresson (2020).
"""

from __future__ import annotations

import numpy as np
import torch

from dronemon.roadmap.graph import Roadmap
from dronemon.types import FloatArray

NUM_EIGENVECTORS = 32


def laplacian_encoding(roadmap: Roadmap, num_eigenvectors: int = NUM_EIGENVECTORS) -> FloatArray:
    """Eigenvectors of the smallest eigenvalues but the constant one's, zeros where there are fewer.

    Each has unit length and its entry of greatest magnitude positive. -> (V, num_eigenvectors).
    """
    # Differs from STAMP: its Laplacian is unsymmetric because np.matmul wrote into the degrees.
    count = min(num_eigenvectors, roadmap.num_nodes - 1)
    laplacian = torch.as_tensor(_normalised_laplacian(roadmap))
    vectors = torch.linalg.eigh(laplacian).eigenvectors.numpy()[:, 1 : 1 + count]
    peak = np.abs(vectors).argmax(axis=0)
    signed = vectors * np.sign(np.take_along_axis(vectors, peak[None], axis=0))
    return np.pad(signed, ((0, 0), (0, num_eigenvectors - count)))


def _normalised_laplacian(roadmap: Roadmap) -> FloatArray:
    """I - D^-1/2 A D^-1/2 of the roadmap's edges without their directions. -> (V, V)."""
    is_joined = np.zeros((roadmap.num_nodes, roadmap.num_nodes), dtype=bool)
    is_joined[np.arange(roadmap.num_nodes)[:, None], roadmap.neighbours] = True
    np.fill_diagonal(is_joined, False)
    adjacency = (is_joined | is_joined.T).astype(np.float64)
    scale = 1.0 / np.sqrt(adjacency.sum(axis=1))
    laplacian: FloatArray = np.eye(roadmap.num_nodes) - scale[:, None] * adjacency * scale
    return laplacian
