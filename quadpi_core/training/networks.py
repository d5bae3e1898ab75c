# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Small networks as training gives them, in numpy: they are stored and evaluated without PyTorch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array


@dataclass(frozen=True)
class Networks:
    """B networks of D inputs, H hidden units and O outputs, all on standardised inputs and targets.

    Attributes:
        hidden_weights: (B, H, D).
        hidden_biases: (B, H).
        output_weights: (B, O, H).
        output_biases: (B, O).
    """

    hidden_weights: Array
    hidden_biases: Array
    output_weights: Array
    output_biases: Array

    def __post_init__(self) -> None:
        members, hidden, _ = self.hidden_weights.shape
        outputs = self.output_biases.shape[-1]
        expected = ((members, hidden), (members, outputs, hidden), (members, outputs))
        shapes = (self.hidden_biases.shape, self.output_weights.shape, self.output_biases.shape)
        if shapes != expected:
            raise ModelError(f"networks of shapes {shapes}, expected {expected}")

    def __len__(self) -> int:
        return len(self.hidden_weights)

    def __getitem__(self, some: slice) -> Networks:
        return Networks(*(getattr(self, column.name)[some] for column in fields(self)))

    def outputs(self, standardised: Array) -> Array:
        """Outputs (B, N, O) for standardised inputs (N, D): the reference for the compiled kernels."""
        hidden = np.einsum("bhd,nd->bnh", self.hidden_weights, standardised) + self.hidden_biases[:, None]
        outputs: Array = np.einsum("boh,bnh->bno", self.output_weights, np.maximum(hidden, 0.0))
        return outputs + self.output_biases[:, None]

    @classmethod
    def stored(cls, arrays: Mapping[str, Array]) -> Networks:
        """Read the arrays of a model folder.

        Raises:
            ModelError: for an array that is missing, shapes that do not fit together, or networks of nothing.
        """
        names = [column.name for column in fields(cls)]
        if missing := [name for name in names if name not in arrays]:
            raise ModelError(f"networks without {missing[0]}")
        values = [arrays[name].astype(float) for name in names]
        if [value.ndim for value in values] != [3, 2, 3, 2] or any(value.size == 0 for value in values):
            raise ModelError(f"networks of shapes {[value.shape for value in values]}")
        return cls(*values)
