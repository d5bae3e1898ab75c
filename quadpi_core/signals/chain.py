# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One low-pass for all signals of a flight, so that they share one delay, offline and live."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX, Quaternion4
from quadpi_core.signals.filters import DELAYS, SECTIONS, zero_phase

# Columns of the signals of a sample, offline and live: velocity over ground [m/s] in body axes, attitude body
# to world, rates [rad/s], specific force [m/s²] in body axes, rotor speeds [rad/s], as many as the vehicle
# has rotors, and wind [m/s] in the world.
VELOCITY, ATTITUDE, RATES, SPECIFIC_FORCE = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)
ROTOR_SPEEDS, WIND = slice(13, -3), slice(-3, None)


def channels(rotors: int) -> int:
    """Number of signals of a vehicle, by the number of its rotors."""
    return 16 + rotors


class FilteredSignals(NamedTuple):
    """The signals that a model and its measured wrench need, after the low-pass.

    Attributes:
        velocity: (K, 3) m/s over ground, body axes.
        attitude: (K, 4) body to world, of unit norm.
        rates: (K, 3) rad/s.
        specific_force: (K, 3) m/s², body axes.
        rotor_speeds: (K, rotors) rad/s.
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

    # Of a vehicle with fewer rotors, its channels one after the other, and the rest unused.
    delays: Annotated[Array, SECTIONS, DELAYS, channels(ROTORS_MAX)]
    attitude: Quaternion4  # the last one, with the sign that it was filtered with
    started: bool


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
    samples[:, ATTITUDE] = make_continuous(attitude)
    filtered = zero_phase(samples, cutoff_hz, rate_hz, derivative_of=RATES)
    return _unpack(filtered.value, filtered.derivative)


def make_continuous(attitude: Array) -> Array:
    """The quaternions (N, 4), each with the sign nearest to the previous one.

    q and −q are the same attitude, but their mean is not an attitude.
    """
    continuous = np.array(attitude, dtype=np.float64, order="C")
    compiled.make_continuous(continuous, np.zeros(4))
    return continuous


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
