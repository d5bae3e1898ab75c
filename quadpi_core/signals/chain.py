# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One low-pass for all signals of a flight, so that they share one delay, offline and live."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.records import Quaternion4, Vector3, columns_of
from quadpi_core.signals.filters import (
    DELAYS,
    SECTIONS,
    LowPass,
    low_pass,
    settled_state,
    zero_phase,
)
from quadpi_core.vehicle import ROTORS


class Signals:
    """The signals of a sample, offline and live. The low-pass takes them as one row of numbers."""

    velocity: Vector3  # m/s over ground, body axes
    attitude: Quaternion4  # body to world
    rates: Vector3  # rad/s
    specific_force: Vector3  # m/s², body axes
    rotor_speeds: Annotated[Array, ROTORS]  # rad/s
    wind: Vector3  # m/s, world


VELOCITY, ATTITUDE, RATES, SPECIFIC_FORCE, ROTOR_SPEEDS, WIND = columns_of(Signals)
CHANNELS = WIND.stop


class FilteredSignals(NamedTuple):
    """The signals that a model and its measured wrench need, after the low-pass.

    Attributes:
        velocity: (K, 3) m/s over ground, body axes.
        attitude: (K, 4) body to world, of unit norm.
        rates: (K, 3) rad/s.
        specific_force: (K, 3) m/s², body axes.
        rotor_speeds: (K, 4) rad/s.
        wind: (K, 3) m/s, world.
        angular_acceleration: (K, 3) rad/s², the derivative of `rates`.
    """

    velocity: Array
    attitude: Array
    rates: Array
    specific_force: Array
    rotor_speeds: Array
    wind: Array
    angular_acceleration: Array


class ChainMemory:
    """What the causal low-pass over all signals remembers; all zeros before the first sample."""

    delays: Annotated[Array, SECTIONS, DELAYS, CHANNELS]
    attitude: Quaternion4  # the last one, with the sign that it was filtered with
    started: bool


@njit(cache=True)
def forget(memory: ChainMemory) -> None:
    """Forget all samples, after a gap or a jump of the clock: the filter settles at the next one."""
    memory.attitude[:] = 0.0
    memory.started = False


@njit(cache=True)
def filter_sample(
    design: LowPass, memory: ChainMemory, sample: Array, value: Array, slope: Array, curvature: Array
) -> None:
    """Pass one finite sample (20,) through the causal low-pass; the rate is taken as constant.

    Fills `value` (20,), with an attitude of unit norm, `slope` (20,), the derivative per second, and
    `curvature` (4,), the second derivative of the rotor speeds. The
    attitude in `sample` gets the sign nearest to the previous one. The filter starts settled at its first
    sample.
    """
    make_continuous(sample[ATTITUDE].reshape(1, 4), memory.attitude)
    memory.attitude[:] = sample[ATTITUDE]
    if not memory.started:
        memory.delays[:] = settled_state(design, sample)
        memory.started = True
    before = memory.delays[1, 1, ROTOR_SPEEDS].copy()
    low_pass(design, memory.delays, sample.reshape(1, -1), value.reshape(1, -1), slope.reshape(1, -1))
    # s² H(s), as the derivative is s H(s), see `filters`: both factors (1 + z⁻¹) become 2 f (1 − z⁻¹).
    newest, last = memory.delays[1, 0, ROTOR_SPEEDS], memory.delays[1, 1, ROTOR_SPEEDS]
    curvature[:] = 4.0 * design.rate_hz**2 * design.second.gain * (newest - 2.0 * last + before)
    attitude = value[ATTITUDE]
    attitude /= np.sqrt(np.sum(attitude * attitude))


def filter_zero_phase(
    velocity_body: Array,
    attitude: Array,
    rates: Array,
    specific_force: Array,
    rotor_speeds: Array,
    wind: Array,
    *,
    rate_hz: float,
    cutoff_hz: float,
) -> FilteredSignals:
    """Filter a whole flight without delay (see :func:`quadpi_core.signals.filters.zero_phase`).

    Raises:
        SignalError: as :func:`quadpi_core.signals.filters.zero_phase` does.
    """
    samples = _pack(velocity_body, attitude, rates, specific_force, rotor_speeds, wind)
    make_continuous(samples[:, ATTITUDE], np.zeros(4))
    filtered = zero_phase(samples, cutoff_hz, rate_hz, derivative_of=RATES)
    return _unpack(filtered.value, filtered.derivative)


@njit(cache=True)
def make_continuous(attitude: Array, last: Array) -> Array:
    """Give each quaternion (K, 4), in place, the sign nearest to the previous one; returns the last one.

    q and −q are the same attitude, but their mean is not an attitude.
    """
    previous = last.copy()
    for row in range(attitude.shape[0]):
        projection = 0.0
        for component in range(4):
            projection += previous[component] * attitude[row, component]
        sign = -1.0 if projection < 0.0 else 1.0
        for component in range(4):
            attitude[row, component] *= sign
            previous[component] = attitude[row, component]
    return previous


def _pack(*signals: Array) -> Array:
    return np.concatenate(signals, axis=1)


def _unpack(value: Array, angular_acceleration: Array) -> FilteredSignals:
    attitude = value[:, ATTITUDE]
    return FilteredSignals(
        velocity=value[:, VELOCITY],
        attitude=attitude / np.sqrt(np.sum(attitude * attitude, axis=1, keepdims=True)),
        rates=value[:, RATES],
        specific_force=value[:, SPECIFIC_FORCE],
        rotor_speeds=value[:, ROTOR_SPEEDS],
        wind=value[:, WIND],
        angular_acceleration=angular_acceleration,
    )
