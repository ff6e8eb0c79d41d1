"""The compiled covariance against the formula."""

import math

import pytest
import torch

from dronemon.belief import Matern32


def points(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return 4.0 * torch.rand(*shape, 3, generator=generator, dtype=torch.float64)


def formula(a, b):
    scale = math.sqrt(3.0) / torch.tensor([0.1, 0.1, 3.0], dtype=torch.float64)
    r = torch.linalg.vector_norm((a[..., :, None, :] - b[..., None, :, :]) * scale, dim=-1)
    return (1.0 + r) * torch.exp(-r)


@pytest.mark.parametrize(
    ("a", "b"), [((7,), (9,)), ((2, 7), (2, 9)), ((2, 1, 7), (2, 3, 9)), ((0,), (9,)), ((7,), (0,))]
)
def test_covariance_equals_formula(a, b):
    a, b = points(*a), points(*b, seed=1)
    torch.testing.assert_close(Matern32()(a, b), formula(a, b), rtol=1e-13, atol=1e-16)


def test_covariance_of_near_and_far_points():
    near = points(1) + torch.tensor([0.0, 1e-12, 1e-7, 1e-3, 0.01])[:, None].double()
    torch.testing.assert_close(Matern32()(near, near), formula(near, near), rtol=0, atol=1e-14)
    far = 1e5 * torch.arange(5.0, dtype=torch.float64)[:, None].expand(-1, 3)
    assert torch.equal(Matern32()(far, far), torch.eye(5, dtype=torch.float64))


def test_covariance_of_each_point_with_its_set():
    own, sets, index = points(6), points(3, 9, seed=1), torch.tensor([2, 0, 0, 1, 2, 2])
    expected = formula(own[:, None], sets[index])[:, 0]
    torch.testing.assert_close(Matern32().each(own, sets, index), expected, rtol=1e-13, atol=1e-16)
    single = Matern32().each(own.float(), sets.float(), index)
    torch.testing.assert_close(single.double(), expected, rtol=0, atol=1e-5)
