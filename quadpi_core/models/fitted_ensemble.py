# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted ensembles of either kind: networks with what belongs to them, evaluated without PyTorch."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import Numbers, Positive, ReadBy, Real
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.ensemble_kernel import (
    BANKS,
    BIAS,
    ENSEMBLE_AXIS,
    MOST_OUTPUTS,
    UNITS_AT_ONCE,
    WEIGHTS,
    evaluate_kernel,
)
from quadpi_core.models.interval_rules import StoredRule
from quadpi_core.models.model_kind import Evaluation, Fitted, FittedAxis
from quadpi_core.models.regressors import Regressor, RegressorProgram
from quadpi_core.models.simd_lanes import LANES
from quadpi_core.records import Records
from quadpi_core.training.networks import Networks

# Least floor of a spread, relative to the standard deviation of the target.
NOISE_FLOOR = 1e-3


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

    def to_json(self) -> dict[str, Any]:
        """What a model folder keeps."""
        return {name: np.asarray(value).tolist() for name, value in vars(self).items()}


@dataclass(frozen=True)
class EnsembleAxis(FittedAxis):
    """What both kinds of ensemble have of an axis.

    Attributes:
        inputs: D regressors that the networks take.
        scaling: of inputs and target.
        members: B networks.
        rule: gives the interval's factor on the spread.
        rms_spread: root mean square of the spread over the training samples, the unit of relative width.
        floor: least noise, or least half distance of the bounds, as a share of the target's scale.
    """

    inputs: tuple[Annotated[Regressor, ReadBy(Regressor.parse)], ...]
    scaling: Scaling
    members: Annotated[Networks, ReadBy(Networks.stored)]
    rule: StoredRule
    rms_spread: Positive
    floor: Positive = field(default=NOISE_FLOOR, kw_only=True)

    def __post_init__(self) -> None:
        width = self.members.hidden_weights.shape[2]
        if {len(self.scaling.input_mean), len(self.inputs)} != {width}:
            raise ValueError(f"inputs or their scaling do not fit networks of {width} inputs")
        if len(self.members) < 2:
            raise ValueError("a single member has no deviation")

    @property
    def terms(self) -> list[str]:
        """Size of the networks, and their inputs."""
        count, units, _ = self.members.hidden_weights.shape
        return [f"{count} networks of {units} hidden units over", *map(str, self.inputs)]

    @property
    @abstractmethod
    def deviation_weight(self) -> float:
        """Weight of the members' disagreement in the spread."""

    @cached_property
    def banks(self) -> tuple[Networks, ...]:
        """Members, and noise network if there is one, as the kernel takes them."""
        scaling, own = self.scaling, (getattr(self, column.name) for column in fields(self))
        members, *noise = (part for part in own if isinstance(part, Networks))
        prepared = _prepared(members, scaling, scaling.target_mean, scaling.target_scale)
        return prepared, *(_prepared(part, scaling, 0.0, 1.0) for part in noise)


def _prepared(networks: Networks, scaling: Scaling, mean: float, scale: float) -> Networks:
    """Networks that give mean + scale · output on inputs in their own units; an even number of units each."""
    added = (0, networks.hidden_biases.shape[1] % UNITS_AT_ONCE)
    weights = np.pad(networks.hidden_weights / scaling.input_scale, ((0, 0), added, (0, 0)))
    return Networks(
        weights,
        np.pad(networks.hidden_biases, ((0, 0), added)) - weights @ scaling.input_mean,
        np.pad(scale * networks.output_weights, ((0, 0), (0, 0), added)),
        scale * networks.output_biases + mean,
    )


class _Packed(NamedTuple):
    """What the kernel takes of the axes held, padded to the largest with zeros.

    The scaling of inputs, and that of what members give, is in the weights.

    Attributes:
        operations: of the program of all inputs; common products are computed once.
        axes: (6,) sizes and scales.
        source: (6, D) rows of the program that are the inputs.
        hidden: (6, banks, 1 + D, units) biases, then weights; units lie network by network.
        output: (6, banks, outputs, networks, 1 + units) bias, then the weight of each unit.
    """

    operations: Records
    axes: Records
    source: npt.NDArray[np.int64]
    hidden: Array
    output: Array

    def fill(self, axis: int, bank: int, networks: Networks) -> None:
        """Put a bank in its place."""
        count, units, inputs = networks.hidden_weights.shape
        outputs, total = networks.output_biases.shape[1], count * units
        self.axes[axis]["banks"][bank] = inputs, units, count, outputs
        hidden, output = self.hidden[axis, bank], self.output[axis, bank, :outputs, :count]
        hidden[BIAS, :total] = networks.hidden_biases.ravel()
        hidden[WEIGHTS : WEIGHTS + inputs, :total] = networks.hidden_weights.reshape(total, inputs).T
        output[:, :, BIAS] = networks.output_biases.T
        output[:, :, WEIGHTS : WEIGHTS + units] = networks.output_weights.swapaxes(0, 1)


class FittedEnsembles(Fitted):
    """The ensembles of a model; each kind says what an axis of it is."""

    @cached_property
    def _packed(self) -> _Packed:
        program = RegressorProgram.compile(r for own in self.axes.values() for r in own.inputs)
        shapes = [bank.hidden_weights.shape for own in self.axes.values() for bank in own.banks]
        networks, units, inputs = np.max(shapes, axis=0)
        total = max(count * width for count, width, _ in shapes)
        total += -total % LANES
        n = len(AXES)
        packed = _Packed(
            program.operations,
            axes=np.zeros(n, dtype=ENSEMBLE_AXIS),
            source=np.zeros((n, inputs), dtype=np.int64),
            hidden=np.zeros((n, BANKS, WEIGHTS + inputs, total)),
            output=np.zeros((n, BANKS, MOST_OUTPUTS, networks, WEIGHTS + units)),
        )
        start = 0
        for axis, own in self.axes.items():
            k, size = AXES.index(axis), len(own.inputs)
            packed.source[k, :size] = program.outputs[start : start + size]
            start += size
            for bank, part in enumerate(own.banks):
                packed.fill(k, bank, part)
            record = packed.axes[k]
            record["scale"] = own.scaling.target_scale
            record["floor"] = own.scaling.target_scale * own.floor
            record["share"] = own.deviation_weight
            record["rms_spread"] = own.rms_spread
        return packed

    def evaluate(
        self,
        inputs: Array,
        factors: Array,
        derivatives: Records | None = None,  # noqa: ARG002 - for kinds that use them
    ) -> Evaluation:
        """See the base class; the leverage is 0."""
        out = np.zeros((5, len(inputs), len(AXES)))
        evaluate_kernel(inputs, *self._packed, factors, out)
        # Faster one by one than by *out.
        return Evaluation(out[0], out[1], out[2], out[3], out[4])
