# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""All signals of a flight through one low-pass, so that they share one delay: offline and live."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.signals.filters import CausalLowPass, zero_phase

VELOCITY = slice(0, 3)
ATTITUDE = slice(3, 7)
RATES = slice(7, 10)
SPECIFIC_FORCE = slice(10, 13)
ROTOR_SPEEDS = slice(13, 17)
WIND = slice(17, 20)


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


class SignalChain:
    """The causal low-pass over every signal; blocks of any length give the same samples, bit for bit.

    Args:
        rate_hz: the IMU's sample rate, taken as constant.
        cutoff_hz: of the fourth-order Butterworth low-pass.

    Raises:
        SignalError: if the cut-off is not below half the rate.
    """

    def __init__(self, rate_hz: float, cutoff_hz: float) -> None:
        self._low_pass = CausalLowPass(cutoff_hz, rate_hz)
        self._last_attitude = np.zeros(4)

    def reset(self) -> None:
        """Forget the past, after a gap or a jump of the clock."""
        self._low_pass.reset()
        self._last_attitude[:] = 0.0

    def step(
        self,
        velocity_body: Array,
        attitude: Array,
        rates: Array,
        specific_force: Array,
        rotor_speeds: Array,
        wind: Array,
    ) -> FilteredSignals:
        """Filter the next K samples; shapes and units as in :class:`FilteredSignals`.

        Raises:
            SignalError: if a value is not finite; the chain stays as it was.
        """
        samples = _pack(velocity_body, attitude, rates, specific_force, rotor_speeds, wind)
        last_attitude = make_continuous(samples[:, ATTITUDE], self._last_attitude)
        filtered = self._low_pass.step(samples)
        self._last_attitude = last_attitude
        return _unpack(filtered.value, filtered.derivative[:, RATES])


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
    """Choose in place the sign of each quaternion (K, 4) nearest to the one before; gives the last one.

    q and −q are the same attitude, but the average of the two is none.
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
