# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted ensembles: numbers that give centre and spread of an interval, and that can be stored."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np

from quadpi_core.config_schema import Numbers, Positive, Real, Text, parse_config
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import Rule, StoredRule
from quadpi_core.models.regressors import Regressor, RegressorProgram
from quadpi_core.training.networks import Networks

# Least floor of a spread, relative to the standard deviation of the target.
NOISE_FLOOR = 1e-3
Self = TypeVar("Self", bound="FittedEnsemble")


@dataclass(frozen=True)
class FittedEnsemble(ABC):
    """What both kinds of ensemble have; a model folder keeps their fields, networks as arrays.

    Attributes:
        inputs: D regressors that the networks take; None where they take the columns of a table as they are.
        scaling: of inputs and target.
        members: B networks.
        rule: gives the interval's factor on the spread.
        rms_spread: root mean square of the spread over the training samples, the unit of relative width.
        floor: least noise, or least half distance of the bounds, as a share of the target's scale.
        entry: class of what is kept beside the arrays.
    """

    inputs: tuple[Regressor, ...] | None
    scaling: Scaling
    members: Networks
    rule: Rule
    rms_spread: float
    floor: float = field(default=NOISE_FLOOR, kw_only=True)

    method: ClassVar[str]
    entry: ClassVar[type[EnsembleEntry]]

    @cached_property
    def program(self) -> RegressorProgram | None:
        """Evaluates the inputs; None for a table."""
        return None if self.inputs is None else RegressorProgram.compile(self.inputs)

    @property
    def terms(self) -> list[str]:
        """What the prediction is made of, in words."""
        count, units, width = self.members.hidden_weights.shape
        names = [f"column {k}" for k in range(width)] if self.inputs is None else map(str, self.inputs)
        return [f"{count} networks of {units} hidden units over", *names]

    @property
    @abstractmethod
    def deviation_weight(self) -> float:
        """Weight of the members' disagreement in the spread."""

    @abstractmethod
    def centre_and_spread(self, X: Array) -> tuple[Array, Array]:
        """Centre and spread (N,) in numpy: the reference for the compiled kernels."""

    @abstractmethod
    def require_networks(self) -> None:
        """Refuse networks that are not those of the kind.

        Raises:
            ModelError: naming them.
        """

    def features(self, X: Array) -> Array:
        """Standardised inputs (N, D) of the networks from input vectors (N, 19), or from a table (N, D)."""
        return self.scaling.standardised(X if self.program is None else self.program.evaluate(X))

    @property
    def networks(self) -> dict[str, Networks]:
        """All networks, by name: the members first."""
        named = {column.name: getattr(self, column.name) for column in fields(self)}
        return {name: own for name, own in named.items() if isinstance(own, Networks)}

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps as arrays, by name."""
        return {key: a for name, own in self.networks.items() for key, a in own.arrays(name).items()}

    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps beside the arrays."""
        rest = [column.name for column in fields(self) if column.name not in self.networks]
        plain = {name: getattr(self, name) for name in rest}
        scaling = {name: np.asarray(value).tolist() for name, value in vars(self.scaling).items()}
        inputs = None if self.inputs is None else [str(regressor) for regressor in self.inputs]
        return plain | {"inputs": inputs, "scaling": scaling, "rule": self.rule.to_json()}

    @classmethod
    def stored(cls: type[Self], data: dict[str, Any], arrays: dict[str, Array]) -> Self:
        """Read what `to_json` and `arrays` gave.

        Raises:
            ModelError: for numbers that no fit gives.
        """
        parts = vars(parse_config(cls.entry, data, cls.method, ModelError))
        inputs = None if parts["inputs"] is None else tuple(map(Regressor.parse, parts["inputs"]))
        networks = {column.name for column in fields(cls)} - set(parts)
        fitted = cls(**parts | {"inputs": inputs} | {n: Networks.stored(arrays, n) for n in networks})
        width = fitted.members.hidden_weights.shape[2]
        if len(fitted.scaling.input_mean) != width or (inputs is not None and len(inputs) != width):
            raise ModelError(f"inputs or their scaling do not fit networks of {width} inputs")
        fitted.require_networks()
        return fitted


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
        input_scale = np.where(input_scale > 0.0, input_scale, 1.0)
        return cls(inputs.mean(axis=0), input_scale, float(target.mean()), target_scale)

    def standardised(self, inputs: Array) -> Array:
        """Inputs (N, D) as the networks take them."""
        standardised: Array = (inputs - self.input_mean) / self.input_scale
        return standardised


@dataclass(frozen=True, kw_only=True)
class EnsembleEntry:
    """What a stored model keeps of either kind of ensemble beside the arrays."""

    inputs: tuple[Text, ...] | None
    scaling: Scaling
    rule: StoredRule
    rms_spread: Positive
    floor: Positive
