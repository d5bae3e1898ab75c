# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Members of an ensemble as plain numbers: one hidden layer of rectified linear units, linear outputs."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

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
        found = (self.hidden_biases.shape, self.output_weights.shape, self.output_biases.shape)
        if found != expected:
            raise ModelError(f"networks of shapes {found}, expected {expected}")

    def __len__(self) -> int:
        return len(self.hidden_weights)

    def __getitem__(self, some: slice) -> Networks:
        return Networks(*(getattr(self, column.name)[some] for column in fields(self)))

    def outputs(self, standardised: Array) -> Array:
        """Outputs (B, N, O) for standardised inputs (N, D): the reference for the compiled kernels."""
        hidden = np.einsum("bhd,nd->bnh", self.hidden_weights, standardised) + self.hidden_biases[:, None]
        outputs: Array = np.einsum("boh,bnh->bno", self.output_weights, np.maximum(hidden, 0.0))
        return outputs + self.output_biases[:, None]

    def arrays(self, prefix: str) -> dict[str, Array]:
        """The arrays by name, as stored."""
        return {
            f"{prefix}.{column.name}": np.ascontiguousarray(getattr(self, column.name))
            for column in fields(self)
        }

    @classmethod
    def stored(cls, arrays: dict[str, Array], prefix: str) -> Networks:
        """Read what :meth:`arrays` gave.

        Raises:
            ModelError: for shapes that do not fit together, or networks of nothing.
            KeyError: for a missing array.
        """
        values = [arrays[f"{prefix}.{column.name}"].astype(float) for column in fields(cls)]
        if [value.ndim for value in values] != [3, 2, 3, 2] or any(value.size == 0 for value in values):
            raise ModelError(f"{prefix}: networks of shapes {[value.shape for value in values]}")
        return cls(*values)


@dataclass(frozen=True)
class Scaling:
    """Standardisation of inputs (D,) and target: (value − mean) / scale."""

    input_mean: Array
    input_scale: Array
    target_mean: float
    target_scale: float

    @classmethod
    def of(cls, inputs: Array, target: Array) -> Scaling:
        """Mean and standard deviation of training samples (N, D) and (N,); a constant input keeps its unit.

        Raises:
            ModelError: if the target is constant.
        """
        input_scale, target_scale = inputs.std(axis=0), float(target.std())
        if target_scale == 0.0:
            raise ModelError("the target is constant: there is nothing to identify")
        return cls(
            inputs.mean(axis=0),
            np.where(input_scale > 0.0, input_scale, 1.0),
            float(target.mean()),
            target_scale,
        )

    def standardised(self, inputs: Array) -> Array:
        """Inputs (N, D) as the networks take them."""
        standardised: Array = (inputs - self.input_mean) / self.input_scale
        return standardised

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, as stored with a model."""
        return {
            "input_mean": self.input_mean.tolist(),
            "input_scale": self.input_scale.tolist(),
            "target_mean": self.target_mean,
            "target_scale": self.target_scale,
        }

    @classmethod
    def from_json(cls, data: dict[str, Any], inputs: int) -> Scaling:
        """Read what `to_json` gave, for so many inputs.

        Raises:
            ModelError: for another number of inputs, or numbers that no samples give.
        """
        scaling = cls(
            np.array(data["input_mean"], dtype=float),
            np.array(data["input_scale"], dtype=float),
            float(data["target_mean"]),
            float(data["target_scale"]),
        )
        if scaling.input_mean.shape != (inputs,) or scaling.input_scale.shape != (inputs,):
            raise ModelError(f"scaling of {scaling.input_mean.size} inputs, expected {inputs}")
        means = np.append(scaling.input_mean, scaling.target_mean)
        scales = np.append(scaling.input_scale, scaling.target_scale)
        if not (np.all(np.isfinite(means)) and np.all((scales > 0.0) & (scales < np.inf))):
            raise ModelError("scaling with a mean that is not finite, or a scale that is not positive")
        return scaling
