# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Training of many small networks as one batch, in PyTorch on a processor or a graphics card.

A step takes one batch of samples for all networks; which of them a network is trained on is a matter of
weights. So ensembles, their subsets and flights left out in turn are one computation: the first layers of all
networks of a table are one matrix product, their gradients another, and Adam updates one vector of all
parameters. As few tables are computed together as keep their activations in the processor's cache.

Shapes: A tables (axes) of M networks each, Q outputs, H hidden units, K inputs with the one for the bias, n
samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor

from quadpi_core.errors import ModelError
from quadpi_core.training.losses import Batch, Batches, Floats, Loss, Samples
from quadpi_core.training.networks import Networks

# Samples that networks are evaluated on at a time.
_TOGETHER = 500
# Most activations that are computed together on a processor, unless one table has more: of 4 bytes each, they
# fit in the 2 MB of cache of a core. A step passes over them seven times. With 30 to 70 networks for each of
# six axes, a step on all axes at once takes 1.3 to 1.4 times as long as axis by axis.
_IN_CACHE = 500_000


class Parts(NamedTuple):
    """Weights of all networks, or the gradient by them.

    Attributes:
        hidden: (A, K, M, H), the last of the K being the biases.
        output: (A, M, Q, H).
        biases: (A, M, Q) of the outputs.
    """

    hidden: Tensor
    output: Tensor
    biases: Tensor

    def of(self, tables: slice) -> Parts:
        """Views of those of some tables."""
        return Parts(self.hidden[tables], self.output[tables], self.biases[tables])


def table_blocks(weights: Parts, n: int) -> list[slice]:
    """Tables that are computed together, for n samples: all on a graphics card, where each call costs."""
    A, M, _, H = weights.output.shape
    size = max(1, min(A, _IN_CACHE // (M * H * n))) if weights.output.device.type == "cpu" else A
    return [slice(start, min(start + size, A)) for start in range(0, A, size)]


class Forward:
    """Outputs of networks for n samples at a time; weights are views, so a call sees their present values.

    Args:
        weights: of the networks.
        n: samples.
        memory: (1 or 2, A M or more, H, n), which others may share: for activations, and for sensitivities of
            :class:`Backward` where it is not to overwrite them; None for own.
    """

    def __init__(self, weights: Parts, n: int, memory: Tensor | None = None) -> None:
        (A, M, Q, H), new = weights.output.shape, weights.output.new_empty
        self.activations = new((A * M, H, n)) if memory is None else memory[0, : A * M]
        self.outputs = new((A, M, Q, n))
        self._of_table, self._of_network = self.activations.view(A, M * H, n), self.outputs.view(A * M, Q, n)
        self._hidden = weights.hidden.flatten(2).transpose(1, 2)
        self._output = weights.output.flatten(0, 1)
        self._biases = weights.biases[..., None]

    def __call__(self, inputs: Tensor) -> Tensor:
        """Outputs (A, M, Q, n) for inputs (A, K, n), which the next call overwrites."""
        torch.bmm(self._hidden, inputs, out=self._of_table).relu_()
        torch.bmm(self._output, self.activations, out=self._of_network)
        return self.outputs.add_(self._biases)


def evaluate(weights: Parts, inputs: Tensor) -> Tensor:
    """Outputs (A, M, Q, N) of networks for inputs (A, K, N)."""
    count = inputs.shape[2]
    n = min(_TOGETHER, count)
    outputs = inputs.new_empty((*weights.biases.shape, count))
    for tables in table_blocks(weights, n):
        forward = Forward(weights.of(tables), n)
        # The last of the parts reaches back, to be as long as the others.
        for start in (*range(0, count - n, n), count - n):
            outputs[tables, ..., start : start + n] = forward(inputs[tables, ..., start : start + n])
    return outputs


class Backward:
    """Gradient by the weights, without autograd, after a forward pass, whose activations it uses up.

    A network computes o = V relu(W x) + c with inputs x, the last of them one, so that W holds the hidden
    biases. With the gradient g = ∂loss/∂o, activations r = relu(W x) and their sign 1[r > 0],

        ∂loss/∂c = Σ g,   ∂loss/∂V = Σ g rᵀ,   ∂loss/∂W = Σ (Vᵀ g · 1[r > 0]) xᵀ,   sums over the samples.

    Memory and views of it are allocated once: for ten networks, making a view takes about as long as using
    it. The memory is that of :class:`Forward`. Units come before samples, so that operations per unit run
    along memory.
    """

    def __init__(self, weights: Parts, gradient: Parts, forward: Forward, memory: Tensor) -> None:
        A, M, Q, H = weights.output.shape
        self._one_output = Q == 1
        self._activations = forward.activations
        self._sensitivities = memory[-1, : A * M]
        self._of_table = self._sensitivities.view(A, M * H, -1).transpose(1, 2)
        self._hidden, self._hidden_slope = weights.hidden.flatten(2), gradient.hidden.flatten(2)
        by_unit = (A, M * H) if Q == 1 else (A * M, Q, H)
        self._output, self._output_slope = weights.output.view(by_unit), gradient.output.view(by_unit)
        self._bias_slope = gradient.biases.view(A * M, Q)

    def __call__(self, inputs: Tensor, slope: Tensor) -> None:
        """Fill the gradient, from inputs (A, K, n) and the gradient by the outputs (A, M, Q, n)."""
        slope = slope.flatten(0, 1)
        torch.sum(slope, -1, out=self._bias_slope)
        if self._one_output:
            # With one output, S = Σ 1[r > 0] g xᵀ serves both layers: ∂loss/∂W = V S, and ∂loss/∂V = Σ g r is
            # the sum of S W over the inputs, as r = 1[r > 0] W x.
            self._sensitivities.sign_().mul_(slope)
            torch.bmm(inputs, self._of_table, out=self._hidden_slope)
            torch.sum(self._hidden_slope * self._hidden, 1, out=self._output_slope)
            self._hidden_slope.mul_(self._output[:, None])
        else:
            torch.bmm(slope, self._activations.transpose(1, 2), out=self._output_slope)
            torch.bmm(self._output.transpose(1, 2), slope, out=self._sensitivities)
            self._sensitivities.mul_(self._activations.sign_())
            torch.bmm(inputs, self._of_table, out=self._hidden_slope)


# Samples that the networks are judged on after an epoch, at most.
_JUDGED = 10_000
# Threads of a training on a processor. The operations of a step take a tenth of a millisecond, and threads
# meet after each. On two idle cores a second thread makes steps 1.5 to 2 times as fast; where another process
# takes one of the cores, each meeting waits until that is done: they become 4 to 9 times as slow.
_THREADS = 1
# Adam's usual constants (Kingma and Ba 2015).
_BETA_1, _BETA_2, _EPSILON = 0.9, 0.999, 1e-8


@dataclass(frozen=True)
class TrainingState:
    """The state of a training after an epoch.

    Attributes:
        stage: name of the training, such as "members".
        epoch: counts from 1 to `epochs`.
        loss: on the samples that a network is trained on, mean over all networks.
        coverage: of nominal intervals on the samples that judge a network, mean over all networks; None where
            there are none.
    """

    stage: str
    epoch: int
    epochs: int
    loss: float
    coverage: float | None


Report: TypeAlias = Callable[[TrainingState], None]
Keep: TypeAlias = Literal["last", "best", "best on average"]


@dataclass(frozen=True)
class Schedule:
    """How networks are trained.

    Attributes:
        hidden: units of the hidden layer.
        epochs: passes over all samples.
        batch: samples of a step; a network is trained on those in its units.
        fewest_steps: of an epoch; a small set of samples is passed several times.
        learning_rate: of Adam.
        keep: networks as they are after the last epoch; each as it was after the epoch with the best score on
            what judges it; or all of a table as they were after that with the best score on average.
        seed: of initial weights and batches.
        device: of PyTorch, for example "cpu" or "cuda".
    """

    hidden: int
    epochs: int
    batch: int
    fewest_steps: int
    learning_rate: float
    keep: Keep
    seed: int
    device: str


def train(
    samples: Samples,
    loss: Loss,
    schedule: Schedule,
    stage: str = "",
    report: Report | None = None,
    start: Training | None = None,
) -> Training:
    """Train networks; on a processor, the same again for the same arguments.

    Args:
        samples: to train on.
        loss: to train to.
        schedule: how.
        stage: name for the report.
        report: called after each epoch.
        start: trained regressors to start from, instead of random weights.

    Raises:
        ModelError: for a device that is not there.
    """
    with torch.inference_mode(), _limited_threads():
        training = Training(samples, loss, schedule, start)
        best = None if schedule.keep == "last" else _Best(training)
        for epoch in range(1, schedule.epochs + 1):
            for batch in training.batches.epoch(training.random, schedule.fewest_steps):
                training.step(batch)
            if best is not None or report is not None:
                losses, scores, coverage = training.judge()
                if best is not None:
                    best.update(scores)
                if report is not None:
                    report(TrainingState(stage, epoch, schedule.epochs, float(losses.mean()), coverage))
        if best is not None:
            best.restore()
        return training


class Training:
    """Networks in training: their parameters, the gradient and Adam's moments, each as one vector."""

    def __init__(
        self, samples: Samples, loss: Loss, schedule: Schedule, start: Training | None = None
    ) -> None:
        self.loss, self.schedule = loss, schedule
        device = device_of(schedule.device)
        self.batches = Batches(samples, schedule.batch, device)
        A, K = self.batches.input_shape
        M, Q, H = len(samples.trained), loss.outputs, schedule.hidden
        self.shape = (A, M, Q, H, K)
        # On the processor for every device: all start from the same weights and see the same batches.
        self.random = torch.Generator().manual_seed(schedule.seed)
        self.parameters = torch.zeros(A * M * (K * H + Q * H + Q), device=device)
        # The gradient and its square; Adam takes the moving mean of both.
        self._powers = self.parameters.new_zeros((2, *self.parameters.shape))
        self._moments, self._scratch = torch.zeros_like(self._powers), torch.zeros_like(self.parameters)
        self._rates = self.parameters.new_tensor([[1.0 - _BETA_1], [1.0 - _BETA_2]])
        self.gradient = self._powers[0]
        self.weights = self.parts(self.parameters)
        self._blocks = self._in_blocks()
        self._epsilon = torch.tensor(_EPSILON, device=device)
        self._steps = 0
        if start is None:
            self._initialise()
        else:
            self._continue(start)

    def _in_blocks(self) -> list[_Block]:
        """The steps of a training by tables, all in the same memory."""
        _, M, Q, H, _ = self.shape
        n, gradient = self.batches.size, self.parts(self.gradient)
        blocks = table_blocks(self.weights, n)
        largest = max(tables.stop - tables.start for tables in blocks)
        memory = self.parameters.new_empty((1 if Q == 1 else 2, largest * M, H, n))
        passes = []
        for tables in blocks:
            weights = self.weights.of(tables)
            forward = Forward(weights, n, memory)
            backward = Backward(weights, gradient.of(tables), forward, memory)
            passes.append(_Block(tables, self.loss.of(tables), forward, backward))
        return passes

    def parts(self, vector: Tensor) -> Parts:
        """Views of a vector of all parameters."""
        A, M, Q, H, K = self.shape
        hidden, output, biases = vector.split([A * K * M * H, A * M * Q * H, A * M * Q])
        return Parts(hidden.view(A, K, M, H), output.view(A, M, Q, H), biases.view(A, M, Q))

    def _initialise(self) -> None:
        """Uniform weights of Glorot and Bengio (2010), biases zero but for those that the loss wants."""
        _, _, Q, H, K = self.shape
        hidden, output, biases = self.weights
        for weights, fans in ((hidden[:, :-1], K - 1 + H), (output, H + Q)):
            uniform = 2.0 * torch.rand(weights.shape, generator=self.random) - 1.0
            weights.copy_(math.sqrt(6.0 / fans) * uniform)
        biases.copy_(self.loss.initial_biases(self.batches.targets()))

    def _continue(self, start: Training) -> None:
        """Begin with what `start` predicts; the biases that the loss wants are in units of its error."""
        for mine, theirs in zip(self.weights, start.weights, strict=True):
            mine.copy_(theirs)
        error = (2.0 * start.judge()[0]).sqrt()
        self.weights[2].add_(self.loss.initial_biases(self.batches.targets()) * error[..., None])

    def step(self, batch: Batch) -> None:
        """One step of Adam."""
        self.differentiate(batch)
        self._steps += 1
        gradient, square = self._powers
        torch.mul(gradient, gradient, out=square)
        mean, spread = self._moments.lerp_(self._powers, self._rates)
        unbias = math.sqrt(1.0 - _BETA_2**self._steps)
        torch.sqrt(spread, out=self._scratch).add_(self._epsilon, alpha=unbias)
        rate = self.schedule.learning_rate * unbias / (1.0 - _BETA_1**self._steps)
        self.parameters.addcdiv_(mean, self._scratch, value=-rate)

    def differentiate(self, batch: Batch) -> None:
        """Fill `gradient`."""
        for tables, loss, forward, backward in self._blocks:
            inputs = batch.inputs[tables]
            backward(inputs, loss.gradient(forward(inputs), batch.targets[tables], batch.weights))

    def predictions(self, networks: slice) -> Floats:
        """Outputs (A, M', Q, N) of some of the networks of each table for all samples."""
        with torch.inference_mode(), _limited_threads():
            hidden, output, biases = self.weights
            some = Parts(hidden[:, :, networks], output[:, networks], biases[:, networks])
            return evaluate(some, self.batches.inputs()).cpu().numpy()

    def judge(self) -> tuple[Tensor, Tensor, float | None]:
        """Losses (A, M) where trained; scores (A, M), NaN for none, and mean coverage where judged."""
        trained, judged = self._to_judge
        outputs = evaluate(self.weights, trained.inputs)
        losses = self.loss.value(outputs, trained.targets, trained.weights)
        seen = judged.weights.any(-1)
        scores = self.loss.score(outputs, judged.targets, judged.weights).masked_fill(~seen, torch.nan)
        if not seen.any():
            return losses, scores, None
        covered = self.loss.covered(outputs, judged.targets, losses) * judged.weights
        return losses, scores, float(covered.sum(-1)[:, seen].mean())

    @cached_property
    def _to_judge(self) -> tuple[Batch, Batch]:
        """Some of all samples, with weights where networks are trained, and where they are judged."""
        batches = self.batches
        step = -(-len(batches) // _JUDGED)
        chosen = torch.arange(0, len(batches), step, device=self.parameters.device)
        return batches.chosen(chosen, batches.trained), batches.chosen(chosen, batches.judged)

    def networks(self) -> list[Networks]:
        """The networks of each table as they are."""
        hidden, output, biases = (part.cpu().numpy().astype(np.float64) for part in self.weights)
        weights = np.ascontiguousarray(hidden[:, :-1].transpose(0, 2, 3, 1))
        return [Networks(*parts) for parts in zip(weights, hidden[:, -1], output, biases, strict=True)]


class _Block(NamedTuple):
    """What a step computes together: the gradient of some tables."""

    tables: slice
    loss: Loss
    forward: Forward
    backward: Backward


class _Best:
    """The networks of a training as they were when their scores were best."""

    def __init__(self, training: Training) -> None:
        self.training = training
        self.scores = torch.full(training.shape[:2], torch.inf, device=training.parameters.device)
        self.parameters = training.parameters.clone()

    def update(self, scores: Tensor) -> None:
        """Keep the networks with their least scores (A, M) so far; the latest where there is none (NaN)."""
        if self.training.schedule.keep == "best on average":
            scores = scores.nanmean(dim=1, keepdim=True).expand_as(scores)
        better = ~(scores >= self.scores)
        self.scores = torch.where(better, scores, self.scores)
        shapes = (better[:, None, :, None], better[:, :, None, None], better[:, :, None])
        parts = (self.training.parts(vector) for vector in (self.parameters, self.training.parameters))
        for kept, now, mask in zip(*parts, shapes, strict=True):
            kept.copy_(torch.where(mask, now, kept))

    def restore(self) -> None:
        """Make them the trained ones."""
        self.training.parameters.copy_(self.parameters)


@contextmanager
def _limited_threads() -> Iterator[None]:
    """Limit the threads of PyTorch to those of a training."""
    usual = torch.get_num_threads()
    torch.set_num_threads(min(usual, _THREADS))
    try:
        yield
    finally:
        torch.set_num_threads(usual)


def device_of(name: str) -> torch.device:
    """A device of PyTorch by name.

    Raises:
        ModelError: if it is not there.
    """
    try:
        return torch.zeros(0, device=name).device
    except (RuntimeError, AssertionError) as error:
        raise ModelError(f"device {name!r} is not there: {str(error).splitlines()[0]}") from error
