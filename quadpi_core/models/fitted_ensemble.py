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
from quadpi_core.core import compiled
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import StoredRule
from quadpi_core.models.model_kind import CompiledFitted, FittedAxis
from quadpi_core.models.regressors import BASE_ROWS, Regressor, RegressorProgram
from quadpi_core.records import Records
from quadpi_core.training.networks import Networks

# Least floor of a spread, relative to the standard deviation of the target.
NOISE_FLOOR = 1e-3
# Two banks of networks share the inputs of an axis: its members, and the noise network if it has one.
_BANKS = 2
# Size of one bank, all zero where there is none, and where its weights start.
_BANK = np.dtype([(name, np.int64) for name in ("inputs", "units", "networks", "outputs", "start")])
# One axis: its banks; scale of the target; least noise or spread, in the target's own unit; weight of the
# members' disagreement; `rms_spread`.
_AXIS = np.dtype(
    [
        ("banks", _BANK, (_BANKS,)),
        ("scale", np.float64),
        ("floor", np.float64),
        ("share", np.float64),
        ("rms_spread", np.float64),
    ],
    align=True,
)


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
    def from_samples(cls, inputs: Array, target: Array) -> Scaling:
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
        return (inputs - self.input_mean) / self.input_scale

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
        scaling, parts = self.scaling, (getattr(self, column.name) for column in fields(self))
        members, *noise = (part for part in parts if isinstance(part, Networks))
        prepared = _prepared(members, scaling, scaling.target_mean, scaling.target_scale)
        return prepared, *(_prepared(part, scaling, 0.0, 1.0) for part in noise)


def _prepared(networks: Networks, scaling: Scaling, mean: float, scale: float) -> Networks:
    """Networks that give mean + scale · output on inputs in their own units; an even number of units each."""
    weights = networks.hidden_weights / scaling.input_scale
    added = (0, networks.hidden_biases.shape[1] % 2)
    return Networks(
        np.pad(weights, ((0, 0), added, (0, 0))),
        np.pad(networks.hidden_biases - np.sum(weights * scaling.input_mean, axis=-1), ((0, 0), added)),
        np.pad(scale * networks.output_weights, ((0, 0), (0, 0), added)),
        scale * networks.output_biases + mean,
    )


def _flat(networks: Networks) -> Array:
    """The weights of a bank one after the other, as `Bank` of the compiled core has them."""
    count, units, inputs = networks.hidden_weights.shape
    hidden = networks.hidden_weights.reshape(count * units, inputs).T
    output = np.concatenate((networks.output_biases[..., np.newaxis], networks.output_weights), axis=2)
    parts = networks.hidden_biases, hidden, output.swapaxes(0, 1)
    return np.concatenate([part.ravel() for part in parts])


class _Packed(NamedTuple):
    """What the compiled core takes of the axes held, and memory for a block of samples.

    The scaling of inputs, and that of what members give, is in the weights.

    Attributes:
        operations: of the program of all inputs; common products are computed once.
        axes: (6,) sizes and scales.
        source: (6, D) rows of the program that are the inputs.
        weights: of all banks, one after the other.
        rows: of the program.
        activations: of all hidden units of a bank.
        outputs: (banks, outputs, networks, samples).
    """

    operations: Records
    axes: Records
    source: npt.NDArray[np.int64]
    weights: Array
    rows: Array
    activations: Array
    outputs: Array


class FittedEnsembles(CompiledFitted):
    """The ensembles of a model, of leverage 0; each kind says what an axis of it is."""

    @cached_property
    def compiled(self) -> compiled.Ensembles:
        """See the base class."""
        program = RegressorProgram.compile(r for own in self.axes.values() for r in own.inputs)
        axes = np.zeros(len(AXES), dtype=_AXIS)
        source = np.zeros((len(AXES), max(len(axis.inputs) for axis in self.axes.values())), dtype=np.int64)
        weights, first, start = [], 0, 0
        for axis, own in self.axes.items():
            k, size = AXES.index(axis), len(own.inputs)
            source[k, :size] = program.outputs[first : first + size]
            first += size
            record = axes[k]
            for bank, networks in enumerate(own.banks):
                count, units, _ = networks.hidden_weights.shape
                record["banks"][bank] = size, units, count, networks.output_biases.shape[1], start
                weights.append(_flat(networks))
                start += len(weights[-1])
            record["scale"] = own.scaling.target_scale
            record["floor"] = own.scaling.target_scale * own.floor
            record["share"] = own.deviation_weight
            record["rms_spread"] = own.rms_spread
        banks, block = axes["banks"], compiled.ENSEMBLE_BLOCK
        packed = _Packed(
            program.operations,
            axes,
            source,
            np.concatenate(weights),
            rows=np.zeros((BASE_ROWS + len(program.operations), block)),
            activations=np.empty((banks["networks"] * banks["units"]).max()),
            outputs=np.empty((_BANKS, compiled.MOST_OUTPUTS, banks["networks"].max(), block)),
        )
        return compiled.Ensembles(packed)
