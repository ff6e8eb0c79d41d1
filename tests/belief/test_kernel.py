"""The covariance, in torch and compiled, against the formula."""

import math

import numpy as np
import pytest
import torch

from dronemon.belief import Matern32
from dronemon.belief.covariance import fill_row


def points(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return 4.0 * torch.rand(*shape, 3, generator=generator, dtype=torch.float64)


def formula(a, b):
    scale = math.sqrt(3.0) / torch.tensor([0.1, 0.1, 3.0], dtype=torch.float64)
    r = torch.linalg.vector_norm((a[..., :, None, :] - b[..., None, :, :]) * scale, dim=-1)
    return (1.0 + r) * torch.exp(-r)


def compiled(a, b):
    """What the compiled loops make of two sets of points. (n, 3), (m, 3) -> (n, m)."""
    scale = Matern32().scale(a)
    columns, out = np.ascontiguousarray((b * scale).numpy().T), np.empty((len(a), len(b)))
    for point, row in zip((a * scale).numpy(), out, strict=True):
        fill_row(point, columns, len(b), row)
    return torch.as_tensor(out)


@pytest.mark.parametrize("covariance", [Matern32(), compiled])
@pytest.mark.parametrize(("a", "b"), [(7, 9), (0, 9), (7, 0)])
def test_covariance_equals_formula(covariance, a, b):
    a, b = points(a), points(b, seed=1)
    torch.testing.assert_close(covariance(a, b), formula(a, b), rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize(("a", "b"), [((2, 7), (2, 9)), ((2, 1, 7), (2, 3, 9))])
def test_covariance_of_batches_equals_formula(a, b):
    a, b = points(*a), points(*b, seed=1)
    torch.testing.assert_close(Matern32()(a, b), formula(a, b), rtol=1e-13, atol=1e-16)
    single = Matern32()(a.float(), b.float())
    torch.testing.assert_close(single.double(), formula(a, b), rtol=0, atol=1e-5)


@pytest.mark.parametrize("covariance", [Matern32(), compiled])
def test_covariance_of_near_and_far_points(covariance):
    near = points(1) + torch.tensor([0.0, 1e-12, 1e-7, 1e-3, 0.01])[:, None].double()
    torch.testing.assert_close(covariance(near, near), formula(near, near), rtol=0, atol=1e-14)
    far = 1e5 * torch.arange(5.0, dtype=torch.float64)[:, None].expand(-1, 3)
    assert torch.equal(covariance(far, far), torch.eye(5, dtype=torch.float64))
