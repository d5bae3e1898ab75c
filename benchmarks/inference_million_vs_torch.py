# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A million samples through bootstrap ensembles of six axes, against eager PyTorch with one bmm per layer.

PyTorch gets inputs that are scaled already, single precision, and blocks of the size that suits it best; the
kernel starts from input vectors, in double precision. Both use one thread.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks import Result, UnavailableError, interleaved_seconds
from benchmarks.random_ensembles import random_ensembles, simulation_inputs
from benchmarks.synthetic_inputs import smooth_inputs
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.model_kind import Fitted
from quadpi_core.models.regressors import RegressorProgram
from quadpi_core.training.networks import Networks

NAMES = ("inference_million_vs_torch",)

SAMPLES = 1_000_000
BLOCKS = (250, 1000, 4000, 20_000, 100_000)
SAMPLES_PER_BLOCK_SIZE = 100_000


def run() -> list[Result]:
    try:
        import torch
    except ImportError as error:
        raise UnavailableError("PyTorch is not installed") from error
    X = smooth_inputs(SAMPLES, seed=1)
    fitted = random_ensembles("bootstrap", X[:10_000], simulation_inputs())
    factors = fitted.factors(0.95)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        eager = EagerBatches(fitted, X, factors)
        check_equal(eager, fitted.evaluate(X[:1000], factors))
        few = [lambda size=size: eager.evaluate(SAMPLES_PER_BLOCK_SIZE, size) for size in BLOCKS]
        block = BLOCKS[int(np.argmin(interleaved_seconds(few, repetitions=3).min(axis=0)))]
        functions = (lambda: eager.evaluate(SAMPLES, block), lambda: fitted.evaluate(X, factors))
        theirs, ours = interleaved_seconds(functions).T
    finally:
        torch.set_num_threads(threads)
    baseline = (
        f"PyTorch {torch.__version__} in blocks of {block}: {np.median(theirs):.2f} s, "
        f"kernel: {np.median(ours):.2f} s, one thread each"
    )
    return [Result(NAMES[0], float(np.median(theirs / ours)), "times", baseline)]


class EagerBatches:
    """The same ensembles in PyTorch, all members of all axes as one batch; missing inputs are zeros."""

    def __init__(self, fitted: Fitted, X: Array, factors: Array) -> None:
        import torch

        widest = max(len(ensemble.scaling.input_mean) for ensemble in fitted.axes.values())

        def tensor(values: Array) -> Any:
            return torch.from_numpy(values.astype(np.float32))

        def filled_up(values: Array) -> Array:
            return np.pad(values, [*[(0, 0)] * (values.ndim - 1), (0, widest - values.shape[-1])])

        def layers(banks: list[Networks]) -> tuple[Any, ...]:
            return (
                tensor(np.concatenate([filled_up(bank.hidden_weights) for bank in banks]).swapaxes(1, 2)),
                tensor(np.concatenate([bank.hidden_biases for bank in banks])[:, None]),
                tensor(np.concatenate([bank.output_weights for bank in banks]).swapaxes(1, 2)),
                tensor(np.concatenate([bank.output_biases for bank in banks])[:, None]),
            )

        ensembles = [fitted.axes[axis] for axis in AXES]
        features = [
            own.scaling.standardised(RegressorProgram.compile(own.inputs).evaluate(X)) for own in ensembles
        ]
        self.inputs = torch.stack([tensor(filled_up(own)) for own in features])
        self.members = layers([ensemble.members for ensemble in ensembles])
        self.noise = layers([ensemble.noise for ensemble in ensembles])
        columns = [[e.scaling.target_mean, e.scaling.target_scale, e.floor, e.model_share] for e in ensembles]
        self.constants = tensor(np.column_stack((columns, factors))).T[:, :, None]

    def evaluate(self, samples: int, block: int) -> list[Any]:
        """Predicted, lower and upper (6, block) of each block."""
        import torch

        with torch.inference_mode():
            return [self._block(start, start + block) for start in range(0, samples, block)]

    def _block(self, start: int, stop: int) -> tuple[Any, ...]:
        import torch

        mean, scale, floor, share, factor = self.constants
        inputs = self.inputs[:, start:stop]
        axes, samples, width = inputs.shape
        each = len(self.members[0]) // axes
        of_members = inputs[:, None].expand(-1, each, -1, -1).reshape(-1, samples, width)
        outputs = _forward(of_members, *self.members).view(axes, each, samples)
        noise = torch.nn.functional.softplus(_forward(inputs, *self.noise)[:, :, 0]) + floor
        centre = mean + scale * outputs.mean(dim=1)
        half = factor * scale * torch.sqrt(share * outputs.var(dim=1) + noise * noise)
        return centre, centre - half, centre + half


def _forward(inputs: Any, weights: Any, biases: Any, weights_out: Any, biases_out: Any) -> Any:
    import torch

    return torch.baddbmm(biases_out, torch.baddbmm(biases, inputs, weights).relu_(), weights_out)


def check_equal(eager: EagerBatches, evaluation: Any) -> None:
    """Both evaluate the same, as far as single precision goes."""
    samples = len(evaluation.predicted)
    (block,) = eager.evaluate(samples, samples)
    for theirs, ours in zip(block, (evaluation.predicted, evaluation.lower, evaluation.upper), strict=True):
        np.testing.assert_allclose(theirs.numpy().T, ours, rtol=1e-3, atol=1e-4)
