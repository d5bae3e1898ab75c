# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted ensembles: numbers that give centre and spread of an interval, and that can be stored."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import AnyRule, rule_from_json
from quadpi_core.models.regressors import Regressor, RegressorProgram
from quadpi_core.training.networks import Networks

# Least floor of a spread, relative to the standard deviation of the target.
NOISE_FLOOR = 1e-3


@dataclass(frozen=True)
class FittedEnsemble(ABC):
    """What both kinds of ensemble have.

    Attributes:
        inputs: D regressors that the networks take; None where they take the columns of a table as they are.
        scaling: of inputs and target.
        members: B networks.
        rule: gives the interval's factor on the spread.
        rms_spread: root mean square of the spread over the training samples, the unit of relative width.
        floor: least noise, or least half distance of the bounds, as a share of the target's scale.
    """

    inputs: tuple[Regressor, ...] | None
    scaling: Scaling
    members: Networks
    rule: AnyRule
    rms_spread: float
    floor: float = field(default=NOISE_FLOOR, kw_only=True)

    method: ClassVar[str]

    @cached_property
    def program(self) -> RegressorProgram | None:
        """Evaluates the inputs; None for a table."""
        return None if self.inputs is None else RegressorProgram.compile(self.inputs)

    @property
    def terms(self) -> list[str]:
        """What the prediction is made of, in words."""
        size = self.members.hidden_weights.shape
        names = [f"column {k}" for k in range(size[2])] if self.inputs is None else map(str, self.inputs)
        return [f"{size[0]} networks of {size[1]} hidden units over", *names]

    @property
    @abstractmethod
    def deviation_weight(self) -> float:
        """Weight of the members' disagreement in the spread."""

    @property
    def noise_network(self) -> Networks | None:
        """A network for the noise; None where the members themselves give the spread."""
        return None

    @abstractmethod
    def centre_and_spread(self, X: Array) -> tuple[Array, Array]:
        """Centre and spread (N,) in numpy: the reference for the compiled kernels."""

    @abstractmethod
    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps as arrays, by name."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps beside the arrays."""

    @classmethod
    @abstractmethod
    def stored(cls, data: dict[str, Any], arrays: dict[str, Array]) -> FittedEnsemble:
        """Read what `to_json` and `arrays` gave.

        Raises:
            ModelError: for numbers that no fit gives.
        """

    def features(self, X: Array) -> Array:
        """Standardised inputs (N, D) of the networks from input vectors (N, 19), or from a table (N, D)."""
        return self.scaling.standardised(X if self.program is None else self.program.evaluate(X))

    def _json(self) -> dict[str, Any]:
        return {
            "inputs": None if self.inputs is None else [str(regressor) for regressor in self.inputs],
            "scaling": self.scaling.to_json(),
            "rule": self.rule.to_json(),
            "rms_spread": self.rms_spread,
            "floor": self.floor,
        }


def read_common(data: dict[str, Any], members: Networks) -> dict[str, Any]:
    """Constructor arguments that both kinds share, from what `to_json` gave.

    Raises:
        ModelError: for numbers that no fit gives.
    """
    inputs = None
    if data["inputs"] is not None:
        inputs = tuple(Regressor.parse(text) for text in data["inputs"])
        if len(inputs) != members.hidden_weights.shape[2]:
            raise ModelError(f"{len(inputs)} inputs for networks of {members.hidden_weights.shape[2]}")
    rms_spread, floor = float(data["rms_spread"]), float(data["floor"])
    if not (0.0 < rms_spread < np.inf and 0.0 < floor < np.inf):
        raise ModelError(f"rms_spread {rms_spread} or floor {floor} is not positive")
    return {
        "inputs": inputs,
        "scaling": Scaling.from_json(data["scaling"], members.hidden_weights.shape[2]),
        "members": members,
        "rule": rule_from_json(data["rule"]),
        "rms_spread": rms_spread,
        "floor": floor,
    }


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
