# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What networks are trained to: losses, and their gradients with respect to the outputs.

All act on the networks of one batch together. Outputs (A, M, O, n) are those of A tables with M networks
each; targets (A, 1 or M, C, n) hold C numbers per sample; weights (M, n) add up to one for each network over
the samples that it sees, the others having none. Everything is standardised.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, TypeAlias

import torch
from torch import Tensor
from torch.nn.functional import softplus

# Published forms of the quality-driven loss, see :class:`QualityDriven`.
QualityDrivenForm: TypeAlias = Literal["sqrt-n", "paper", "pearce"]

# Quantile of the normal distribution for intervals of 95 %.
_NOMINAL = 1.959963984540054
# To start from, relative to the standard deviation of the target.
_LEAST_NOISE = 1e-2


class Loss(Protocol):
    """What training needs of a loss."""

    outputs: ClassVar[int]

    def initial_biases(self, targets: Tensor) -> Tensor:
        """Output biases, broadcastable to (A, M, O), that training starts from."""

    def gradient(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Gradient (A, M, O, n) of :meth:`value` with respect to the outputs, which it may overwrite."""

    def value(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Loss (A, M) of each network."""

    def score(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """What networks (A, M) are judged by on samples that they do not see, the less the better."""

    def covered(self, outputs: Tensor, targets: Tensor, loss: Tensor) -> Tensor:
        """Which samples (A, M, n) lie in a nominal interval of a network with training loss (A, M)."""


@dataclass(frozen=True)
class SquaredError:
    """Half the mean of (y − ŷ)², one output; target y. Its interval is ŷ ± 1.96 root mean square."""

    outputs: ClassVar[int] = 1

    def initial_biases(self, targets: Tensor) -> Tensor:
        """Zero: the target is standardised."""
        return targets.new_zeros(1)

    def gradient(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Weighted ŷ − y."""
        return outputs.sub_(targets).mul_(weights[:, None])

    def value(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Half the mean square."""
        return 0.5 * ((outputs - targets).square()[:, :, 0] * weights).sum(-1)

    def score(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Half the mean square."""
        return self.value(outputs, targets, weights)

    def covered(self, outputs: Tensor, targets: Tensor, loss: Tensor) -> Tensor:
        """Whether the error is below 1.96 times the root of the training loss."""
        return (outputs - targets).square()[:, :, 0] <= 2.0 * _NOMINAL**2 * loss[..., None]


@dataclass(frozen=True)
class GaussianNoise:
    """½ [ln v + e²/v] with v = σ² + s², one output o; targets e² and s² (van Beers and de Visser, Eq. 21).

    σ = softplus(o) + floor is positive for any output. e² is the squared error of an ensemble on data
    that it was not trained on and s² its own variance there. The paper takes r² = max(e² − s², 0) for e² and
    nothing for s², which is biased upward where e² falls below s².
    """

    outputs: ClassVar[int] = 1

    floor: Tensor

    def initial_biases(self, targets: Tensor) -> Tensor:
        """Start from constant noise, of the size of the errors."""
        size = targets[:, :, :1].mean(-1).sqrt().clamp(min=_LEAST_NOISE)
        return torch.log(torch.expm1(size))

    def gradient(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Weighted σ (1 − e²/v) / v · dσ/do."""
        noise = softplus(outputs).add_(self.floor[..., None, None])
        variance = noise.square().add_(targets[:, :, 1:])
        slope = (1.0 - targets[:, :, :1] / variance).div_(variance).mul_(noise)
        return slope.mul_(torch.sigmoid(outputs)).mul_(weights[:, None])

    def value(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Mean negative logarithm of the likelihood, but for a constant."""
        variance = self._variance(outputs, targets)
        return (0.5 * (variance.log() + targets[:, :, 0] / variance) * weights).sum(-1)

    def score(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """The same likelihood."""
        return self.value(outputs, targets, weights)

    def covered(self, outputs: Tensor, targets: Tensor, loss: Tensor) -> Tensor:  # noqa: ARG002
        """Whether the error is below 1.96 √v."""
        return targets[:, :, 0] <= _NOMINAL**2 * self._variance(outputs, targets)

    def _variance(self, outputs: Tensor, targets: Tensor) -> Tensor:
        return (softplus(outputs[:, :, 0]) + self.floor[..., None]).square() + targets[:, :, 1]


@dataclass(frozen=True)
class QualityDriven:
    """Narrow intervals that cover: MPIW_c + weight · max(0, confidence − PICP_s)², outputs L and U; target y.

    MPIW_c is the mean width of the intervals that hold their measurement, PICP_s the mean of
    σ(s (y − L)) σ(s (U − y)) with the sigmoid σ and a softening s that suits targets of unit variance.

    Four sources give three weights, with n samples in the batch and α = 1 − confidence:

    - "paper": λ n (van Beers and de Visser, Eq. 22);
    - "pearce": λ n / (α (1 − α)) (Pearce et al. 2018, Eq. 15);
    - "sqrt-n": λ √n, what the code of both does, with λ = 15 and 1.

    Attributes:
        samples: n.
        factor: λ.
        crossing: weight of the mean square of max(0, L − U), which is zero in all four: bounds that cross
            have a negative width, and shrink it further.
    """

    outputs: ClassVar[int] = 2

    confidence: float
    samples: int
    form: QualityDrivenForm
    factor: float
    softening: float
    crossing: float

    def initial_biases(self, targets: Tensor) -> Tensor:
        """Wide bounds: narrow ones cover nothing at first, and feel the samples near them only."""
        return targets.new_tensor([-_NOMINAL, _NOMINAL])

    def gradient(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Of both terms and the penalty; membership of MPIW_c counts as constant."""
        lower, upper, y = outputs[:, :, 0], outputs[:, :, 1], targets[:, :, 0]
        held = self._held(lower, upper, y) * weights
        held /= held.sum(-1, keepdim=True).clamp_(min=1e-6)
        above, below = self._soft(lower, upper, y)
        soft = above * below
        missing = (self.confidence - (soft * weights).sum(-1, keepdim=True)).clamp_(min=0.0)
        push = (2.0 * self.softening) * self._weight * missing * (soft * weights)
        crossed = (lower - upper).clamp_(min=0.0).mul_(weights).mul_(2.0 * self.crossing)
        return torch.stack(
            [push * (1.0 - above) - held + crossed, held - push * (1.0 - below) - crossed], dim=2
        )

    def value(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Loss of each network."""
        lower, upper, y = outputs[:, :, 0], outputs[:, :, 1], targets[:, :, 0]
        held = self._held(lower, upper, y) * weights
        width = ((upper - lower) * held).sum(-1) / held.sum(-1).clamp(min=1e-6)
        above, below = self._soft(lower, upper, y)
        missing = (self.confidence - (above * below * weights).sum(-1)).clamp(min=0.0)
        crossed = ((lower - upper).clamp(min=0.0).square() * weights).sum(-1)
        return width + self._weight * missing.square() + self.crossing * crossed

    def score(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """The interval score of Winkler: width, plus 2/α times the distance outside.

        Other than the loss, it tells bounds that miss by little from those that miss by much.
        """
        lower, upper, y = outputs[:, :, 0], outputs[:, :, 1], targets[:, :, 0]
        outside = (lower - y).clamp(min=0.0) + (y - upper).clamp(min=0.0)
        return (((upper - lower).abs() + 2.0 / (1.0 - self.confidence) * outside) * weights).sum(-1)

    def covered(self, outputs: Tensor, targets: Tensor, loss: Tensor) -> Tensor:  # noqa: ARG002
        """Whether the bounds hold the target."""
        return self._held(outputs[:, :, 0], outputs[:, :, 1], targets[:, :, 0])

    @property
    def _weight(self) -> float:
        if self.form == "sqrt-n":
            return self.factor * math.sqrt(self.samples)
        if self.form == "paper":
            return self.factor * self.samples
        return self.factor * self.samples / (self.confidence * (1.0 - self.confidence))

    @staticmethod
    def _held(lower: Tensor, upper: Tensor, y: Tensor) -> Tensor:
        return (lower <= y) & (y <= upper)

    def _soft(self, lower: Tensor, upper: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        return torch.sigmoid((y - lower) * self.softening), torch.sigmoid((upper - y) * self.softening)
