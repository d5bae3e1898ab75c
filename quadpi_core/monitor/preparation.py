# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From sensor samples to filtered inputs and the measured wrench: what models of one cut-off share."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.flight import MAX_GAP_NS, RATE_MAX_RAD_S, SPECIFIC_FORCE_MAX_M_S2, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, inputs_kernel, relative_to_air, vehicle_constants
from quadpi_core.signals.chain import FilteredSignals, SignalChain
from quadpi_core.signals.wrench import newton_euler
from quadpi_core.vehicle import Vehicle

# Beyond these a sample is a broken sensor or a wrong unit, not flight.
AIRSPEED_MAX_M_S = 100.0
QUATERNION_NORM_TOLERANCE = 0.1

_NO_STAMP = np.iinfo(np.int64).min


# The arguments of `Preparation.step` after the stamps, in their order.
Signals: TypeAlias = tuple[Array, ...]


class _Plausible(NamedTuple):
    """Largest magnitudes that a sample may hold."""

    velocity: float
    rates: float
    specific_force: float
    rotor_speed: float
    gap_ns: int


class Prepared(NamedTuple):
    """K samples, U of them usable.

    Attributes:
        time_ns: (K,) stamps.
        usable: (K,) False for a sample that cannot be judged.
        inputs: (U, 19) input vectors of the usable samples.
        measured: (U, 6) their measured wrench, N and Nm, body axes.
    """

    time_ns: Stamps
    usable: npt.NDArray[np.bool_]
    inputs: Array
    measured: Array


class Preparation:
    """Judges and filters the samples of one vehicle; memory and time per sample are constant.

    Args:
        vehicle: as in its vehicle file.
        rate_hz: sample rate of the IMU.
        cutoff_hz: of the low-pass.

    Raises:
        SignalError: if the sample rate is too low for the cut-off.
    """

    def __init__(self, vehicle: Vehicle, rate_hz: float, cutoff_hz: float) -> None:
        self._chain = SignalChain(rate_hz, cutoff_hz)
        self._constants = vehicle_constants(vehicle)
        self._mass, self._inertia = vehicle.mass_kg, vehicle.inertia
        self._limits = _Plausible(
            AIRSPEED_MAX_M_S,
            RATE_MAX_RAD_S,
            SPECIFIC_FORCE_MAX_M_S2,
            vehicle.rotor_speed_spike_rad_s,
            MAX_GAP_NS,
        )
        self._previous_ns = np.array([_NO_STAMP])

    def reset(self) -> None:
        """Forget the past: as after construction."""
        self._chain.reset()
        self._previous_ns[0] = _NO_STAMP

    def step(
        self,
        time_ns: Stamps,
        velocity_body: Array,
        attitude: Array,
        rates: Array,
        specific_force: Array,
        rotor_speeds: Array,
        wind_world: Array,
    ) -> Prepared:
        """Take K samples; see :meth:`quadpi_core.monitor.Monitor.step`."""
        signals: Signals = (velocity_body, attitude, rates, specific_force, rotor_speeds, wind_world)
        usable = np.empty(len(time_ns), dtype=np.bool_)
        restart = np.empty(len(time_ns), dtype=np.bool_)
        used, restarts = _judge(time_ns, signals, self._limits, self._previous_ns, usable, restart)
        if used < len(time_ns):
            restart = restart[usable]
            signals = tuple(signal[usable] for signal in signals)
        filtered = self._filter(signals, restart, restarts)
        velocity_air = relative_to_air(filtered.velocity, filtered.attitude, filtered.wind)
        inputs = np.empty((used, len(INPUT_NAMES)))
        inputs_kernel(
            velocity_air, filtered.attitude, filtered.rates, filtered.rotor_speeds, *self._constants, inputs
        )
        measured = newton_euler(
            filtered.specific_force, filtered.rates, filtered.angular_acceleration, self._mass, self._inertia
        )
        return Prepared(time_ns, usable, inputs, measured)

    def _filter(self, signals: Signals, restart: npt.NDArray[np.bool_], restarts: int) -> FilteredSignals:
        """The low-pass over all signals, started anew at the marked samples."""
        samples = len(restart)
        if samples == 0:
            no_acceleration = np.empty((0, 3))
            return FilteredSignals._make((*signals, no_acceleration))
        if restarts == 0:
            return self._chain.step(*signals)
        starts = np.flatnonzero(restart)
        parts = []
        for start, stop in pairwise(sorted({0, *starts.tolist(), samples})):
            if restart[start]:
                self._chain.reset()
            parts.append(self._chain.step(*(signal[start:stop] for signal in signals)))
        return FilteredSignals(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@njit(cache=True)
def _within(values: Any, limit: float) -> bool:
    """Whether every magnitude is finite and at most `limit`; NaN compares as false."""
    within = True
    for value in values:
        within &= abs(value) <= limit
    return within


@njit(cache=True)
def _judge(
    time_ns: Any, signals: Any, limits: Any, previous_ns: Any, usable: Any, restart: Any
) -> tuple[int, int]:
    """Mark which samples can be used and where the low-pass must start anew; return both counts."""
    velocity, attitude, rates, specific_force, rotor_speeds, wind = signals
    used, restarts = 0, 0
    for i in range(time_ns.size):
        step_ns = time_ns[i] - previous_ns[0]
        first = previous_ns[0] == _NO_STAMP
        jump = not first and abs(step_ns) > limits.gap_ns
        norm_square = 0.0
        for component in attitude[i]:
            norm_square += component * component
        usable[i] = (
            (first or jump or step_ns > 0)
            and abs(np.sqrt(norm_square) - 1.0) <= QUATERNION_NORM_TOLERANCE
            and _within(velocity[i], limits.velocity)
            and _within(wind[i], limits.velocity)
            and _within(rates[i], limits.rates)
            and _within(specific_force[i], limits.specific_force)
            and _within(rotor_speeds[i], limits.rotor_speed)
            and rotor_speeds[i].min() >= 0.0
        )
        restart[i] = jump
        if usable[i]:
            used += 1
            restarts += jump
            previous_ns[0] = time_ns[i]
    return used, restarts
