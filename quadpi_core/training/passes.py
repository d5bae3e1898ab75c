# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Forward and backward pass of many small networks at once, without autograd.

A network computes o = V relu(W x) + c with inputs x, the last of them one, so that W holds the hidden biases.
With the gradient g = ∂loss/∂o, activations r = relu(W x) and their sign 1[r > 0],

    ∂loss/∂c = Σ g,   ∂loss/∂V = Σ g rᵀ,   ∂loss/∂W = Σ (Vᵀ g · 1[r > 0]) xᵀ,   sums over the samples.

Memory and views of it are allocated once: for ten networks, making a view takes about as long as using it.

Shapes: A tables (axes) of M networks each, Q outputs, H hidden units, K inputs with the one for the bias, n
samples. Units come before samples, so that operations per unit run along memory.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

# Samples that networks are evaluated on at a time.
_TOGETHER = 500


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


class Forward:
    """Outputs of networks for n samples at a time; weights are views, so a call sees their present values."""

    def __init__(self, weights: Parts, n: int) -> None:
        (A, M, Q, H), new = weights.output.shape, weights.output.new_empty
        self.activations, self.outputs = new((A * M, H, n)), new((A, M, Q, n))
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
    forward = Forward(weights, n)
    outputs = inputs.new_empty((*weights.biases.shape, count))
    # The last of the blocks reaches back, to be as long as the others.
    for start in (*range(0, count - n, n), count - n):
        outputs[..., start : start + n] = forward(inputs[..., start : start + n])
    return outputs


class Backward:
    """Gradient by the weights, after a forward pass, whose activations it uses up."""

    def __init__(self, weights: Parts, gradient: Parts, forward: Forward) -> None:
        A, M, Q, H = weights.output.shape
        self._one_output = Q == 1
        self._activations = forward.activations
        self._sensitivities = self._activations if Q == 1 else torch.empty_like(self._activations)
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
