# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted ensembles: numbers that give centre and spread of an interval, and that can be stored."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from quadpi_core.config_schema import Numbers, Positive, Real, Text
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import Rule, StoredRule
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
    rule: Rule
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


@dataclass(frozen=True)
class Scaling:
    """Standardisation of inputs (D,) and target: (value − mean) / scale."""

    input_mean: Annotated[Array, Numbers()]
    input_scale: Annotated[Array, Numbers()]
    target_mean: Real
    target_scale: Positive

    def __post_init__(self) -> None:
        if self.input_mean.shape != self.input_scale.shape or np.any(self.input_scale <= 0.0):
            raise ValueError("each input needs a mean and a positive scale")

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


@dataclass(frozen=True, kw_only=True)
class EnsembleEntry:
    """What a stored model keeps of either kind of ensemble beside the arrays."""

    inputs: tuple[Text, ...] | None
    scaling: Scaling
    rule: StoredRule
    rms_spread: Positive
    floor: Positive

    def parts(self, members: Networks) -> dict[str, Any]:
        """Constructor arguments of a fitted ensemble with these members.

        Raises:
            ModelError: for networks over another number of inputs.
        """
        inputs = None if self.inputs is None else tuple(Regressor.parse(text) for text in self.inputs)
        width = members.hidden_weights.shape[2]
        if len(self.scaling.input_mean) != width or (inputs is not None and len(inputs) != width):
            raise ModelError(f"inputs or their scaling do not fit networks of {width} inputs")
        own = ("scaling", "rule", "rms_spread", "floor")
        return {"inputs": inputs, "members": members, **{name: getattr(self, name) for name in own}}
