# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Losses: their published formulas, and gradients beside those of autograd."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from quadpi_core.training.losses import GaussianNoise, Loss, SquaredError  # noqa: E402

from .small_trainings import LOSSES, NETWORKS, TABLES, quality_driven  # noqa: E402


@pytest.mark.parametrize("loss", LOSSES, ids=str)
def test_gradient_by_output_is_that_of_autograd(loss: Loss) -> None:
    random = torch.Generator().manual_seed(5)
    outputs = torch.randn((TABLES, NETWORKS, loss.outputs, 40), generator=random, dtype=torch.double)
    targets = torch.rand((TABLES, 1, 2, 40), generator=random, dtype=torch.double)
    weights = torch.rand((NETWORKS, 40), generator=random, dtype=torch.double)
    weights /= weights.sum(-1, keepdim=True)
    if not isinstance(loss, GaussianNoise):
        targets = targets[:, :, :1]
    variable = outputs.clone().requires_grad_()
    (expected,) = torch.autograd.grad(loss.value(variable, targets, weights).sum(), variable)
    assert expected.abs().max() > 1e-3
    torch.testing.assert_close(loss.gradient(outputs, targets, weights), expected)


@pytest.mark.parametrize(
    ("form", "weight"), [("sqrt-n", 0.7 * 60**0.5), ("paper", 0.7 * 60), ("pearce", 0.7 * 60 / (0.9 * 0.1))]
)
def test_quality_driven_loss_is_its_published_formula(form: str, weight: float) -> None:
    rng = np.random.default_rng(2)
    lower, upper, y = rng.normal(-0.8, 0.5, 60), rng.normal(0.8, 0.5, 60), rng.normal(size=60)
    held = (lower <= y) & (y <= upper)
    width = np.sum((upper - lower)[held]) / held.sum()
    soft = np.mean(1.0 / (1.0 + np.exp(-8.0 * (y - lower))) / (1.0 + np.exp(-8.0 * (upper - y))))
    expected = width + weight * max(0.0, 0.9 - soft) ** 2
    found = quality_driven(form, crossing=0.0).value(
        torch.from_numpy(np.stack((lower, upper)))[None, None],
        torch.from_numpy(y)[None, None, None],
        torch.full((1, 60), 1.0 / 60, dtype=torch.double),
    )
    assert soft < 0.9
    assert float(found) == pytest.approx(expected, rel=1e-9)


def test_crossing_bounds_cost() -> None:
    bounds = torch.tensor([[[[0.5], [-0.5]]]])
    target, weight = torch.zeros((1, 1, 1, 1)), torch.ones((1, 1))
    values = [float(quality_driven(crossing=c).value(bounds, target, weight)) for c in (0.0, 2.0)]
    assert values[1] - values[0] == pytest.approx(2.0, rel=1e-6)


def one_network(values):
    """A tensor (1, 1, O, n) of rows of numbers."""
    return torch.tensor(np.atleast_2d(values), dtype=torch.double)[None, None]


EVEN = torch.full((1, 4), 0.25, dtype=torch.double)


def test_half_the_mean_square() -> None:
    loss = SquaredError()
    outputs, targets = one_network([1.0, 2.0, 3.0, 4.0]), one_network([1.0, 1.0, 1.0, 1.0])
    assert float(loss.value(outputs, targets, EVEN)) == pytest.approx(0.5 * (0 + 1 + 4 + 9) / 4)
    assert float(loss.score(outputs, targets, EVEN)) == float(loss.value(outputs, targets, EVEN))
    assert not loss.initial_biases(targets).any()


def test_noise_is_judged_by_the_likelihood_of_a_normal_distribution() -> None:
    """σ = ln(1 + e^o) + floor, plus the variance of the members."""
    from scipy.stats import norm

    raw, errors, variance = np.array([-1.0, 0.0, 1.0, 2.0]), np.array([0.1, -0.5, 2.0, 0.0]), 0.3
    deviation = np.sqrt((np.log1p(np.exp(raw)) + 0.05) ** 2 + variance)
    expected = -norm.logpdf(errors, scale=deviation).mean() - 0.5 * np.log(2.0 * np.pi)
    loss = GaussianNoise(torch.tensor([[0.05]], dtype=torch.double))
    targets = one_network([errors**2, np.full(4, variance)])
    assert float(loss.value(one_network(raw), targets, EVEN)) == pytest.approx(expected)
    inside = np.abs(errors) < 1.96 * deviation
    covered = loss.covered(one_network(raw), targets, torch.zeros(1, 1))
    assert covered[0, 0].tolist() == inside.astype(float).tolist()


@pytest.mark.parametrize(("squares", "noise"), [([4.0, 0.0, 2.0, 2.0], 2.0**0.5), ([1e-9] * 4, 0.01)])
def test_noise_starts_at_the_size_of_the_errors_but_no_less_than_a_hundredth(squares, noise) -> None:
    targets = one_network([squares, [0.0] * 4])
    bias = GaussianNoise(torch.zeros(1, 1)).initial_biases(targets)
    assert float(torch.nn.functional.softplus(bias)) == pytest.approx(noise)


def test_bounds_are_judged_by_the_interval_score() -> None:
    """Width, plus 2/α of the distance outside, with α = 0.1."""
    outputs = one_network([[-1.0, -1.0, -1.0, -1.0], [1.0, 1.0, 1.0, 1.0]])
    targets = one_network([0.0, 1.5, -1.25, 1.0])
    score = float(quality_driven().score(outputs, targets, EVEN))
    assert score == pytest.approx(2.0 + (2.0 / 0.1) * (0.5 + 0.25) / 4)
    covered = quality_driven().covered(outputs, targets, torch.zeros(1, 1))
    assert covered[0, 0].tolist() == [1.0, 0.0, 0.0, 1.0]


def test_an_interval_of_a_regressor_is_twice_its_error() -> None:
    """Of a loss of ½ the root mean square is one: 1.96 is the half width."""
    targets = one_network([1.9, 2.0, -1.95, -1.97])
    covered = SquaredError().covered(torch.zeros_like(targets), targets, torch.tensor([[0.5]]))
    assert covered[0, 0].tolist() == [1.0, 0.0, 1.0, 0.0]


def test_bounds_that_hold_nothing_have_no_width_and_a_finite_gradient() -> None:
    outputs, targets = one_network([[1.0] * 4, [2.0] * 4]), one_network([[-9.0] * 4])
    assert float(quality_driven().value(outputs, targets, EVEN)) == pytest.approx(0.7 * 60**0.5 * 0.9**2)
    assert torch.isfinite(quality_driven().gradient(outputs, targets, EVEN)).all()
