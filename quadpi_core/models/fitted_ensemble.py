# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted ensembles: numbers that give centre and spread of an interval, and that can be stored."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, TypeAlias

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import AnyRule, rule_from_json
from quadpi_core.models.regressors import Regressor, RegressorProgram
from quadpi_core.training.networks import Networks

# Least floor of a spread, relative to the standard deviation of the target.
NOISE_FLOOR = 1e-3


@dataclass(frozen=True)
class FittedEnsemble:
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
class FittedBootstrap(FittedEnsemble):
    """Members that predict the target, and one network that predicts the variance of the noise.

    centre = mean of the members, spread² = model_share · their variance (B − 1) + noise² (van Beers and de
    Visser, Eq. 18 to 20).

    Attributes:
        noise: one network; noise = softplus(output) + floor, as a share of the target's scale.
        model_share: 1 in the paper; more in the default, for there are few members (see `BootstrapEnsemble`).
    """

    method: ClassVar[str] = "bootstrap"
    noise: Networks
    model_share: float

    def centre_and_spread(self, X: Array) -> tuple[Array, Array]:
        """Centre and spread (N,) in numpy: the reference for the compiled kernels."""
        features = self.features(X)
        predictions = self.members.outputs(features)[:, :, 0]
        noise = np.logaddexp(0.0, self.noise.outputs(features)[0, :, 0]) + self.floor
        variance = self.model_share * predictions.var(axis=0, ddof=1) + noise**2
        scale = self.scaling.target_scale
        return self.scaling.target_mean + scale * predictions.mean(axis=0), scale * np.sqrt(variance)

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps as arrays, by name."""
        return self.members.arrays("members") | self.noise.arrays("noise")

    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps beside the arrays."""
        return self._json() | {"model_share": self.model_share}

    @classmethod
    def stored(cls, data: dict[str, Any], arrays: dict[str, Array]) -> FittedBootstrap:
        """Read what `to_json` and `arrays` gave.

        Raises:
            ModelError: for numbers that no fit gives.
        """
        members, noise = Networks.stored(arrays, "members"), Networks.stored(arrays, "noise")
        common = read_common(data, members)
        shapes = (members.output_biases.shape[1], noise.output_biases.shape, noise.hidden_weights.shape[2])
        if shapes != (1, (1, 1), members.hidden_weights.shape[2]) or len(members) < 2:
            raise ModelError("members and noise network do not fit together")
        model_share = float(data["model_share"])
        if not 0.0 < model_share < np.inf:
            raise ModelError(f"model_share {model_share} is not positive")
        return cls(**common, noise=noise, model_share=model_share)


@dataclass(frozen=True)
class FittedQualityDriven(FittedEnsemble):
    """Members that predict a lower and an upper bound.

    Each bound of the ensemble is the mean of the members', moved outward by `outward` standard deviations
    (B − 1), for both the mean of the two bounds': a member astray on one side would else pull the middle
    after it. Centre and spread are the middle of the two and half their distance, but no less than the floor.

    Attributes:
        outward: 1.96 with the standard deviation, 1.96/√B with the standard error of the mean.
    """

    method: ClassVar[str] = "quality-driven"
    outward: float

    def centre_and_spread(self, X: Array) -> tuple[Array, Array]:
        """Centre and spread (N,) in numpy: the reference for the compiled kernels."""
        bounds = self.members.outputs(self.features(X))
        mean, deviation = bounds.mean(axis=0), bounds.std(axis=0, ddof=1)
        half = 0.5 * (mean[:, 1] - mean[:, 0]) + self.outward * deviation.mean(axis=1)
        spread = np.maximum(np.abs(half), self.floor)
        scale = self.scaling.target_scale
        return self.scaling.target_mean + scale * mean.mean(axis=1), scale * spread

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps as arrays, by name."""
        return self.members.arrays("members")

    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps beside the arrays."""
        return self._json() | {"outward": self.outward}

    @classmethod
    def stored(cls, data: dict[str, Any], arrays: dict[str, Array]) -> FittedQualityDriven:
        """Read what `to_json` and `arrays` gave.

        Raises:
            ModelError: for numbers that no fit gives.
        """
        members = Networks.stored(arrays, "members")
        common = read_common(data, members)
        if members.output_biases.shape[1] != 2 or len(members) < 2:
            raise ModelError("members do not give two bounds each")
        outward = float(data["outward"])
        if not 0.0 <= outward < np.inf:
            raise ModelError(f"outward {outward} is negative or not finite")
        return cls(**common, outward=outward)


AnyFitted: TypeAlias = FittedBootstrap | FittedQualityDriven


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
