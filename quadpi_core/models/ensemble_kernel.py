# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""All axes of an ensemble evaluated together in compiled code, without PyTorch.

Two loops do the same sums. A single sample, as in flight, is evaluated with hidden units side by side in
lanes; of many, the samples are side by side. Both take inputs and units in the same order and round at the
same places, so live and replay agree bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.fitted_ensemble import (
    AnyFitted,
    FittedBootstrap,
    FittedQualityDriven,
    Networks,
    Scaling,
)
from quadpi_core.models.methods import Evaluation
from quadpi_core.models.regressors import BASE_ROWS, RegressorProgram, check_inputs, rows_kernel
from quadpi_core.models.simd import LANES, element, filled, fused, load, rectified, store

# Samples whose inputs stay in the cache; a multiple of LANES.
_BLOCK = 256
# Hidden units that share a load of the inputs; an odd one gets a companion of weight 0.
_UNITS_AT_ONCE = 2
# Two banks of networks share the inputs of an axis: its members, and the noise network if it has one.
_MEMBERS, _NOISE, _BANKS = 0, 1, 2
# Of a network: the target, or its lower and upper bound.
_MOST_OUTPUTS = 2


class _Tables(NamedTuple):
    """The fitted axes as the kernel takes them, filled up to the largest with zeros.

    The scaling of inputs, and that of what members give, is in the weights. Units lie network by network.

    Attributes:
        source: (6, D) rows of the program that are the inputs.
        sizes: (6, banks, 4) of a bank: inputs, units of a network, networks, outputs; zeros for none.
        hidden_weights: (6, banks, D, units).
        hidden_biases: (6, banks, units).
        output_weights: (6, banks, outputs, units).
        output_biases: (6, banks, outputs, networks).
        interval: (6, 4) scale of the target; least noise or spread, in the target's own unit; how much the
            members' deviation counts, `model_share` or `outward`; `rms_spread`. One array, for each argument
            of a kernel costs as much as a network.
    """

    source: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    hidden_weights: Array
    hidden_biases: Array
    output_weights: Array
    output_biases: Array
    interval: Array

    @classmethod
    def for_banks(cls, banks: Iterable[Networks]) -> _Tables:
        """Empty tables that hold the largest of the banks."""
        networks, units, inputs = np.max([bank.hidden_weights.shape for bank in banks], axis=0)
        total = networks * units + -(networks * units) % LANES
        axes = len(AXES)
        return cls(
            source=np.zeros((axes, inputs), dtype=np.int64),
            sizes=np.zeros((axes, _BANKS, 4), dtype=np.int64),
            hidden_weights=np.zeros((axes, _BANKS, inputs, total)),
            hidden_biases=np.zeros((axes, _BANKS, total)),
            output_weights=np.zeros((axes, _BANKS, _MOST_OUTPUTS, total)),
            output_biases=np.zeros((axes, _BANKS, _MOST_OUTPUTS, networks)),
            interval=np.ones((axes, 4)),
        )

    def fill(self, axis: int, bank: int, networks: Networks) -> None:
        """Put a bank in its place."""
        count, units, inputs = networks.hidden_weights.shape
        outputs, total = networks.output_biases.shape[1], count * units
        self.sizes[axis, bank] = inputs, units, count, outputs
        self.hidden_weights[axis, bank, :inputs, :total] = networks.hidden_weights.reshape(total, inputs).T
        self.hidden_biases[axis, bank, :total] = networks.hidden_biases.ravel()
        self.output_weights[axis, bank, :outputs, :total] = networks.output_weights.swapaxes(0, 1).reshape(
            outputs, total
        )
        self.output_biases[axis, bank, :outputs, :count] = networks.output_biases.T


@dataclass(frozen=True)
class CompiledEnsembles:
    """The fitted axes of an ensemble packed for :func:`evaluate_kernel`."""

    program: RegressorProgram
    tables: _Tables
    ensembles: Mapping[str, AnyFitted]

    @classmethod
    def pack(cls, ensembles: Mapping[str, AnyFitted]) -> CompiledEnsembles:
        """Pack the axes held; products that their inputs share are computed once.

        Raises:
            ModelError: for networks over the columns of some table.
        """
        for axis, ensemble in ensembles.items():
            if ensemble.inputs is None:
                raise ModelError(f"{axis}: networks over the columns of a table take no input vectors")
        program = RegressorProgram.compile(r for e in ensembles.values() for r in e.inputs or ())
        banks = {axis: _banks(ensemble) for axis, ensemble in ensembles.items()}
        tables = _Tables.for_banks(bank for pair in banks.values() for bank in pair)
        start = 0
        for axis, ensemble in ensembles.items():
            k, size = AXES.index(axis), len(ensemble.scaling.input_mean)
            tables.source[k, :size] = program.outputs[start : start + size]
            start += size
            for bank, networks in enumerate(banks[axis]):
                tables.fill(k, bank, networks)
            scale = ensemble.scaling.target_scale
            share = ensemble.model_share if isinstance(ensemble, FittedBootstrap) else ensemble.outward
            tables.interval[k] = scale, scale * ensemble.floor, share, ensemble.rms_spread
        return cls(program, tables, ensembles)

    def evaluate(self, inputs: Array, factors: Array) -> Evaluation:
        """Evaluate input vectors (N, 19) with :func:`.methods.interval_factors`; the leverage is 0."""
        check_inputs(inputs)
        out = np.zeros((5, len(inputs), len(AXES)))
        program = self.program
        evaluate_kernel(inputs, program.first, program.second, program.weights, *self.tables, factors, out)
        # Faster one by one than by *out.
        return Evaluation(out[0], out[1], out[2], out[3], out[4])


def _banks(ensemble: AnyFitted) -> tuple[Networks, ...]:
    """Members, and noise network if there is one, as the kernel takes them."""
    scaling = ensemble.scaling
    members = _prepared(ensemble.members, scaling, scaling.target_mean, scaling.target_scale)
    if isinstance(ensemble, FittedQualityDriven):
        return (members,)
    return members, _prepared(ensemble.noise, scaling, 0.0, 1.0)


def _prepared(networks: Networks, scaling: Scaling, mean: float, scale: float) -> Networks:
    """Networks that give mean + scale · output on inputs in their own units; an even number of units each."""
    added = (0, networks.hidden_biases.shape[1] % _UNITS_AT_ONCE)
    weights = np.pad(networks.hidden_weights / scaling.input_scale, ((0, 0), added, (0, 0)))
    return Networks(
        weights,
        np.pad(networks.hidden_biases, ((0, 0), added)) - weights @ scaling.input_mean,
        np.pad(scale * networks.output_weights, ((0, 0), (0, 0), added)),
        scale * networks.output_biases + mean,
    )


@njit(cache=True)
def evaluate_kernel(
    inputs: Any,
    first: Any,
    second: Any,
    weights: Any,
    source: Any,
    sizes: Any,
    hidden_weights: Any,
    hidden_biases: Any,
    output_weights: Any,
    output_biases: Any,
    interval: Any,
    factors: Any,
    out: Any,
) -> None:
    """Fill predicted, lower, upper and relative width of `out` (5, N, 6) for the axes held."""
    # Put together here, because a tuple that comes from Python is slow to unpack.
    tables = _Tables(
        source,
        sizes,
        hidden_weights,
        hidden_biases,
        output_weights,
        output_biases,
        interval,
    )
    samples = inputs.shape[0]
    width = min(_BLOCK, samples + -samples % LANES)
    rows = np.zeros((BASE_ROWS + first.shape[0], width))
    hidden = np.empty((1, hidden_biases.shape[2]))
    outputs = np.empty((_BANKS, output_biases.shape[2], output_biases.shape[3], width))
    # What one sample takes is inlined: handing the tables over would cost a fifth of the whole.
    for start in range(0, samples, _BLOCK):
        count = min(samples - start, _BLOCK)
        rows_kernel(inputs[start : start + count], first, second, weights, rows)
        for axis in range(sizes.shape[0]):
            if sizes[axis, _MEMBERS, 2] == 0:
                continue
            for bank in range(_BANKS):
                if count == 1:
                    _one(rows, tables, axis, bank, hidden, outputs)
                else:
                    _many(rows, count, tables, axis, bank, outputs)
            _intervals(start, count, tables, axis, factors[axis], outputs, out)


@njit(cache=True, inline="always")
def _one(rows: Any, tables: Any, axis: int, bank: int, hidden: Any, outputs: Any) -> None:
    """Fill `outputs` (banks, outputs, networks, samples) of one bank for the first sample, units in lanes."""
    inputs, units, networks, count = tables.sizes[axis, bank]
    weights, biases = tables.hidden_weights[axis, bank], tables.hidden_biases[axis]
    weights_out, biases_out = tables.output_weights[axis, bank], tables.output_biases[axis, bank]
    for u in range(0, units * networks, LANES):
        sums = load(biases, bank, u)
        for d in range(inputs):
            sums = fused(element(rows, tables.source[axis, d], 0), load(weights, d, u), sums)
        store(hidden, 0, u, rectified(sums))
    for k in range(count):
        for network in range(networks):
            total = element(biases_out, k, network)
            for u in range(network * units, (network + 1) * units):
                total = fused(element(weights_out, k, u), element(hidden, 0, u), total)
            outputs[bank, k, network, 0] = total


@njit(cache=True)
def _many(rows: Any, samples: int, tables: Any, axis: int, bank: int, outputs: Any) -> None:
    """Fill `outputs` (banks, outputs, networks, samples) of one bank, samples in lanes, two units at a time.

    A second output computes the hidden units again: the registers hold the sums of one.
    """
    inputs, units, networks, count = tables.sizes[axis, bank]
    source = tables.source[axis]
    weights, biases = tables.hidden_weights[axis, bank], tables.hidden_biases[axis]
    weights_out, biases_out = tables.output_weights[axis, bank], tables.output_biases[axis, bank]
    for k in range(count):
        for start in range(0, samples, LANES):
            for network in range(networks):
                sums = filled(element(biases_out, k, network))
                for u in range(network * units, (network + 1) * units, _UNITS_AT_ONCE):
                    v = u + 1
                    sums_u, sums_v = filled(element(biases, bank, u)), filled(element(biases, bank, v))
                    for d in range(inputs):
                        values = load(rows, source[d], start)
                        sums_u = fused(element(weights, d, u), values, sums_u)
                        sums_v = fused(element(weights, d, v), values, sums_v)
                    sums = fused(element(weights_out, k, u), rectified(sums_u), sums)
                    sums = fused(element(weights_out, k, v), rectified(sums_v), sums)
                store(outputs[bank, k], network, start, sums)


@njit(cache=True, inline="always")
def _intervals(
    start: int, samples: int, tables: Any, axis: int, factor: float, outputs: Any, out: Any
) -> None:
    """Fill samples from `start` on of `out` (5, N, 6) from the outputs of both banks."""
    networks, count = tables.sizes[axis, _MEMBERS, 2], tables.sizes[axis, _MEMBERS, 3]
    scale, floor, share, rms_spread = tables.interval[axis]
    for i in range(samples):
        if count == 1:
            centre, variance = _moments(outputs, 0, networks, i)
            noise = scale * _softplus(outputs[_NOISE, 0, 0, i]) + floor
            spread = math.sqrt(share * variance + noise * noise)
        else:
            lower, lower_variance = _moments(outputs, 0, networks, i)
            upper, upper_variance = _moments(outputs, 1, networks, i)
            centre = 0.5 * (lower + upper)
            outward = 0.5 * share * (math.sqrt(lower_variance) + math.sqrt(upper_variance))
            spread = max(abs(0.5 * (upper - lower) + outward), floor)
        out[0, start + i, axis] = centre
        out[1, start + i, axis] = centre - factor * spread
        out[2, start + i, axis] = centre + factor * spread
        out[4, start + i, axis] = spread / rms_spread


@njit(cache=True)
def _moments(outputs: Any, k: int, networks: int, i: int) -> tuple[float, float]:
    """Mean and variance (B − 1) of an output of the members."""
    mean, variance = 0.0, 0.0
    for network in range(networks):
        mean += outputs[_MEMBERS, k, network, i]
    mean /= networks
    for network in range(networks):
        variance += (outputs[_MEMBERS, k, network, i] - mean) ** 2
    return mean, variance / (networks - 1)


@njit(cache=True)
def _softplus(value: float) -> float:
    """log(1 + exp(value)) without overflow."""
    return max(value, 0.0) + math.log(1.0 + math.exp(-abs(value)))
