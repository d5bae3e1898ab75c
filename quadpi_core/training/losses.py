# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Losses that networks are trained with, and their gradients with respect to the outputs.

All act on the networks of one batch together. Outputs (A, M, O, n) are those of A tables with M networks
each; targets (A, 1 or M, C, n) hold C numbers per sample; weights (M, n) add up to one for each network over
its training samples and are zero elsewhere. Everything is standardised. Indicators are stored as floats, one
or zero, in the tensor that they are computed from: boolean tensors and their products with floats are slower.

Gradients are written by hand, in place: with those of :mod:`.train` a training step takes less than half the
time of autograd on the same batched products (`training_vs_batched_autograd`). The formula stands above each.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import softplus

Floats: TypeAlias = npt.NDArray[np.float32]
Flags: TypeAlias = npt.NDArray[np.bool_]

# Steps whose samples are brought together at a time.
_STEPS_TOGETHER = 64


@dataclass(frozen=True)
class Samples:
    """What A tables with M networks each are trained on.

    Attributes:
        inputs: (N, A, D) standardised.
        targets: (N, A, T, C): C numbers per sample, the same for all networks (T = 1) or for each (T = M).
        unit: (N,) unit of each sample; units are in or out as a whole.
        trained: (M, U) units that a network is trained on.
        judged: (M, U) units that judge it after each epoch.
    """

    inputs: Floats
    targets: Floats
    unit: npt.NDArray[np.int32]
    trained: Flags
    judged: Flags


class Batch(NamedTuple):
    """Samples for all networks: n of a step, or of many steps with one more axis in front.

    Attributes:
        inputs: (A, K, n), the last of the K being one, for the bias.
        targets: (A, T, C, n).
        weights: (M, n), of each network adding up to one over the samples that it sees.
    """

    inputs: Tensor
    targets: Tensor
    weights: Tensor


class Batches:
    """Batches of `size` samples from samples kept on a device."""

    def __init__(self, samples: Samples, size: int, device: torch.device) -> None:
        count, tables, width = samples.inputs.shape
        self.size = min(size, count)
        self.input_shape = (tables, width + 1)
        self.target_shape = samples.targets.shape[1:]
        # The numbers of a sample lie together: samples in random order are slow to reach, not to copy.
        ones = np.ones((count, tables, 1), dtype=np.float32)
        inputs = np.concatenate((samples.inputs, ones), axis=2).reshape(count, -1)
        rows = np.concatenate((inputs, samples.targets.reshape(count, -1)), axis=1)
        self.rows = torch.from_numpy(rows).to(device)
        self.unit = torch.from_numpy(samples.unit).to(device)
        self.trained, self.judged = (
            torch.from_numpy(np.ascontiguousarray(flags, dtype=np.float32)).to(device)
            for flags in (samples.trained, samples.judged)
        )
        # Allocated once: fresh memory costs more than writing to it.
        together = _STEPS_TOGETHER * self.size
        self._rows = torch.empty((together, rows.shape[1]), device=device)
        self._weights = torch.empty(len(samples.trained) * together, device=device)

    def __len__(self) -> int:
        return len(self.rows)

    def epoch(self, random: torch.Generator, fewest_steps: int) -> Iterator[Batch]:
        """All samples in random order, several times if they are few, but for a rest smaller than a batch."""
        steps = max(len(self) // self.size, fewest_steps)
        rounds = -(-steps * self.size // len(self))
        order = torch.cat([torch.randperm(len(self), generator=random) for _ in range(rounds)])
        for chosen in order[: steps * self.size].split(_STEPS_TOGETHER * self.size):
            together = self._gather(chosen.to(self.rows.device))
            yield from map(Batch, *(part.unbind() for part in together))

    def _gather(self, chosen: Tensor) -> Batch:
        """The chosen samples as whole steps (S, …)."""
        networks, count = len(self.trained), len(chosen)
        rows = torch.index_select(self.rows, 0, chosen, out=self._rows[:count])
        weights = self._weights[: networks * count].view(networks, count)
        torch.index_select(self.trained, 1, self.unit.index_select(0, chosen), out=weights)
        steps = (-1, self.size)
        return self._batch(rows.unflatten(0, steps), weights.unflatten(1, steps).transpose(0, 1))

    def chosen(self, chosen: Tensor, flags: Tensor) -> Batch:
        """The chosen samples as one batch, with `trained` or `judged` as flags (M, U)."""
        return self._batch(self.rows[chosen], flags.index_select(1, self.unit[chosen]))

    def inputs(self) -> Tensor:
        """Inputs (A, K, N) of all samples."""
        return self._inputs(self.rows.T)

    def targets(self) -> Tensor:
        """Targets (A, T, C, N) of all samples."""
        return self._targets(self.rows.T)

    def _inputs(self, columns: Tensor) -> Tensor:
        tables, width = self.input_shape
        return columns[..., : tables * width, :].unflatten(-2, self.input_shape)

    def _targets(self, columns: Tensor) -> Tensor:
        tables, width = self.input_shape
        return columns[..., tables * width :, :].contiguous().unflatten(-2, self.target_shape)

    def _batch(self, rows: Tensor, weights: Tensor) -> Batch:
        columns = rows.transpose(-1, -2)
        weights.div_(weights.sum(-1, keepdim=True).clamp_(min=1.0))
        return Batch(self._inputs(columns), self._targets(columns), weights)


# Published forms of the quality-driven loss, see :class:`QualityDriven`.
QualityDrivenForm: TypeAlias = Literal["sqrt-n", "paper", "pearce"]

# Quantile of the normal distribution for intervals of 95 %.
_NOMINAL = 1.959963984540054
# Least initial noise, relative to the standard deviation of the target: its logarithm must be finite.
_LEAST_NOISE = 1e-2
# Least sum of the weights that MPIW_c is a mean over: no sample may lie within its bounds.
_LEAST_HELD = 1e-6


class Loss(ABC):
    """What training needs of a loss."""

    outputs: ClassVar[int]

    def of(self, tables: slice) -> Loss:  # noqa: ARG002 - for those with numbers of each table
        """That of some of the tables; the same for all unless overridden."""
        return self

    @abstractmethod
    def initial_biases(self, targets: Tensor) -> Tensor:
        """Output biases, broadcastable to (A, M, O), that training starts from."""

    @abstractmethod
    def gradient(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Gradient (A, M, O, n) of :meth:`value` with respect to the outputs, which it may overwrite."""

    @abstractmethod
    def value(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Loss (A, M) of each network."""

    def score(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Score (A, M) on samples that a network was not trained on, lower is better: the loss by default."""
        return self.value(outputs, targets, weights)

    @abstractmethod
    def covered(self, outputs: Tensor, targets: Tensor, loss: Tensor) -> Tensor:
        """One where samples (A, M, n) lie in a nominal interval of a network with training loss (A, M)."""


@dataclass(frozen=True)
class SquaredError(Loss):
    """Half the mean of (y − ŷ)², one output; target y. Its interval is ŷ ± 1.96 root mean square."""

    outputs: ClassVar[int] = 1

    def initial_biases(self, targets: Tensor) -> Tensor:
        """Zero: the target is standardised."""
        return targets.new_zeros(1)

    def gradient(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """∂/∂ŷ ½ Σ w (y − ŷ)² = w (ŷ − y)."""
        return outputs.sub_(targets).mul_(weights[:, None])

    def value(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Half the mean square."""
        return 0.5 * ((outputs - targets).square()[:, :, 0] * weights).sum(-1)

    def covered(self, outputs: Tensor, targets: Tensor, loss: Tensor) -> Tensor:
        """Where the error is below 1.96 times the root of the mean square, which is twice the loss."""
        return (outputs - targets).square_()[:, :, 0].le_(2.0 * _NOMINAL**2 * loss[..., None])


@dataclass(frozen=True)
class GaussianNoise(Loss):
    """½ [ln v + e²/v] with v = σ² + s², one output o; targets e² and s² (van Beers and de Visser, Eq. 21).

    σ = softplus(o) + floor is positive for any output. e² is the squared error of an ensemble on data
    that it was not trained on and s² its own variance there. The paper takes r² = max(e² − s², 0) for e² and
    nothing for s², which is biased upward where e² falls below s².
    """

    outputs: ClassVar[int] = 1

    floor: Tensor

    @classmethod
    def above(cls, floors: Floats, device: str) -> GaussianNoise:
        """With floors (A, M) on a device."""
        return cls(torch.from_numpy(floors.copy()).to(device))

    def of(self, tables: slice) -> GaussianNoise:
        """With the floors of some tables."""
        return GaussianNoise(self.floor[tables])

    def initial_biases(self, targets: Tensor) -> Tensor:
        """Start from constant noise, of the size of the errors."""
        size = targets[:, :, :1].mean(-1).sqrt().clamp(min=_LEAST_NOISE)
        return torch.log(torch.expm1(size))

    def gradient(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """∂/∂o ½ w [ln v + e²/v] = w (1 − e²/v) / v · σ · dσ/do, with dv = 2 σ dσ and dσ/do = sigmoid(o)."""
        noise = softplus(outputs).add_(self.floor[..., None, None])
        variance = noise.square().add_(targets[:, :, 1:])
        slope = (1.0 - targets[:, :, :1] / variance).div_(variance).mul_(noise)
        return slope.mul_(torch.sigmoid(outputs)).mul_(weights[:, None])

    def value(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Mean negative logarithm of the likelihood, but for a constant."""
        variance = self._variance(outputs, targets)
        return (0.5 * (variance.log() + targets[:, :, 0] / variance) * weights).sum(-1)

    def covered(self, outputs: Tensor, targets: Tensor, loss: Tensor) -> Tensor:  # noqa: ARG002
        """Where the error is below 1.96 √v."""
        return self._variance(outputs, targets).mul_(_NOMINAL**2).ge_(targets[:, :, 0])

    def _variance(self, outputs: Tensor, targets: Tensor) -> Tensor:
        return (softplus(outputs[:, :, 0]) + self.floor[..., None]).square() + targets[:, :, 1]


@dataclass(frozen=True)
class QualityDriven(Loss):
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
        """Wide bounds: narrow ones cover nothing at first, and only samples near a bound have a gradient."""
        return targets.new_tensor([-_NOMINAL, _NOMINAL])

    def gradient(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Gradient with respect to L and U; membership of MPIW_c is taken as constant.

        With a = y − L and b = U − y, how far the target is inside each bound, weights w, held weights
        h = w [a, b ≥ 0] / Σ w [a, b ≥ 0], soft membership m = σ(s a) σ(s b) and the missing coverage
        c = max(0, confidence − Σ w m), the loss is

            Σ h (a + b)  +  weight · c²  +  crossing · Σ w min(0, a + b)²

        As dσ(s a)/da = s σ(s a) (1 − σ(s a)), with g = 2 s · weight · c · w m,

            ∂loss/∂a = h + 2 · crossing · w min(0, a + b) − g (1 − σ(s a)),   and likewise for b;
            ∂loss/∂L = −∂loss/∂a,   ∂loss/∂U = ∂loss/∂b.
        """
        a, b = self._inside(outputs, targets)
        # h + 2 · crossing · w min(0, a + b)
        inside = torch.minimum(a, b).ge_(0.0).mul_(weights)
        inside.div_(inside.sum(-1, keepdim=True).clamp_(min=_LEAST_HELD))
        narrower = inside.addcmul_((a + b).clamp_(max=0.0), weights, value=2.0 * self.crossing)
        # g
        soft_a, soft_b = a.mul_(self.softening).sigmoid_(), b.mul_(self.softening).sigmoid_()
        g = (soft_a * soft_b).mul_(weights)
        missing = (self.confidence - g.sum(-1, keepdim=True)).clamp_(min=0.0)
        g.mul_(missing.mul_(2.0 * self.softening * self._weight))
        # (… − g) + g σ(s a) is … − g (1 − σ(s a)).
        narrower.sub_(g)
        torch.addcmul(narrower, g, soft_a, out=outputs[:, :, 0]).neg_()
        torch.addcmul(narrower, g, soft_b, out=outputs[:, :, 1])
        return outputs

    def value(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """Loss of each network, see :meth:`gradient`."""
        a, b = self._inside(outputs, targets)
        width = a + b
        inside = torch.minimum(a, b).ge_(0.0).mul_(weights)
        mean_width = (width * inside).sum(-1) / inside.sum(-1).clamp(min=_LEAST_HELD)
        soft = torch.sigmoid(a * self.softening) * torch.sigmoid(b * self.softening)
        missing = (self.confidence - (soft * weights).sum(-1)).clamp(min=0.0)
        crossed = (width.clamp(max=0.0).square() * weights).sum(-1)
        return mean_width + self._weight * missing.square() + self.crossing * crossed

    def score(self, outputs: Tensor, targets: Tensor, weights: Tensor) -> Tensor:
        """The interval score of Winkler: width, plus 2/α times the distance outside.

        Unlike the loss, it distinguishes a small miss from a large one.
        """
        a, b = self._inside(outputs, targets)
        outside = a.clamp(max=0.0).add_(b.clamp(max=0.0))
        widths = a.add_(b).abs_()
        return widths.sub_(outside, alpha=2.0 / (1.0 - self.confidence)).mul_(weights).sum(-1)

    def covered(self, outputs: Tensor, targets: Tensor, loss: Tensor) -> Tensor:  # noqa: ARG002
        """Where the bounds hold the target."""
        return torch.minimum(*self._inside(outputs, targets)).ge_(0.0)

    @property
    def _weight(self) -> float:
        if self.form == "sqrt-n":
            return self.factor * math.sqrt(self.samples)
        if self.form == "paper":
            return self.factor * self.samples
        return self.factor * self.samples / (self.confidence * (1.0 - self.confidence))

    @staticmethod
    def _inside(outputs: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
        """Distances (A, M, n) of the target above the lower and below the upper bound."""
        y = targets[:, :, 0]
        return y - outputs[:, :, 0], outputs[:, :, 1] - y
