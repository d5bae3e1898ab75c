# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From complete sensor samples to predictions and the alarm: the same code in a node and in replay."""

from __future__ import annotations

from dataclasses import fields
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.flight import MAX_GAP_NS, RATE_MAX_RAD_S, SPECIFIC_FORCE_MAX_M_S2, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, inputs_kernel, relative_to_air, vehicle_constants
from quadpi_core.intervals.adaptive import AdaptiveFactor
from quadpi_core.monitor.alarm import Alarm, MonitorSettings
from quadpi_core.monitor.output import Alarms, Predictions
from quadpi_core.signals.chain import FilteredSignals, SignalChain
from quadpi_core.signals.wrench import newton_euler
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_core.models.aerodynamic import AerodynamicModel

# Beyond these a sample is a broken sensor or a wrong unit, not flight.
AIRSPEED_MAX_M_S = 100.0
QUATERNION_NORM_TOLERANCE = 0.1

_NO_STAMP = np.iinfo(np.int64).min


# The arguments of `Monitor.step` after the stamps, in their order.
Signals: TypeAlias = tuple[Array, ...]


class _Plausible(NamedTuple):
    """Largest magnitudes that a sample may hold."""

    velocity: float
    rates: float
    specific_force: float
    rotor_speed: float
    gap_ns: int


class Monitor:
    """Watches one vehicle with one model; memory and time per sample are constant.

    Args:
        model: identified for this vehicle.
        vehicle: as in its vehicle file.
        rate_hz: sample rate of the IMU.
        confidence: nominal coverage of the intervals.
        settings: of the alarm, and whether intervals adapt.

    Raises:
        ModelError: if the model belongs to another vehicle or cannot support the confidence.
        SignalError: if the sample rate is too low for the cut-off that the model was identified with.
    """

    def __init__(
        self,
        model: AerodynamicModel,
        vehicle: Vehicle,
        rate_hz: float,
        confidence: float | None = None,
        settings: MonitorSettings | None = None,
    ) -> None:
        model.require(vehicle)
        self.model = model
        self.confidence = model.confidence if confidence is None else confidence
        settings = settings or MonitorSettings()
        self._chain = SignalChain(rate_hz, model.cutoff_hz)
        self._alarm = Alarm(model.envelope, settings)
        self._adaptive = AdaptiveFactor(self.confidence, rate_hz) if settings.adaptive else None
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
        model.evaluate(np.zeros((1, len(INPUT_NAMES))), self.confidence)

    def reset(self) -> None:
        """Forget the past: as after construction."""
        self._chain.reset()
        self._alarm.reset()
        if self._adaptive is not None:
            self._adaptive.reset()
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
    ) -> tuple[Predictions, Alarms]:
        """Take K samples; blocks of any length give the same rows, bit for bit.

        A sample that is not finite, not plausible or not later than the one before gives no prediction and
        counts as BAD_DATA. After a gap or a jump of the stamps the low-pass starts anew; adaptive intervals
        go on, as their coverage is that of all samples so far.

        Args:
            time_ns: (K,) stamps.
            velocity_body: (K, 3) m/s over ground, body axes.
            attitude: (K, 4) body to world.
            rates: (K, 3) rad/s.
            specific_force: (K, 3) m/s², body axes.
            rotor_speeds: (K, 4) rad/s.
            wind_world: (K, 3) m/s, world.
        """
        signals: Signals = (velocity_body, attitude, rates, specific_force, rotor_speeds, wind_world)
        usable = np.empty(len(time_ns), dtype=np.bool_)
        restart = np.empty(len(time_ns), dtype=np.bool_)
        used, restarts = _judge(time_ns, signals, self._limits, self._previous_ns, usable, restart)
        used_ns = time_ns
        if used < len(time_ns):
            used_ns, restart = time_ns[usable], restart[usable]
            signals = tuple(signal[usable] for signal in signals)

        predictions, inputs, leverage = self._predict(used_ns, self._filter(signals, restart, restarts))
        finite = np.empty(used, dtype=np.bool_)
        if not _all_finite(
            predictions.lower, predictions.upper, predictions.measured, leverage, inputs, finite
        ):
            usable[usable] = finite
            predictions = Predictions(
                *(getattr(predictions, column.name)[finite] for column in fields(predictions))
            )
            inputs, leverage = inputs[finite], leverage[finite]
        alarms = self._alarm.step(time_ns, usable, inputs, leverage, predictions.relative_width)
        return predictions, alarms

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

    def _predict(self, time_ns: Stamps, signals: FilteredSignals) -> tuple[Predictions, Array, Array]:
        """Predictions, input vectors (U, 19) and leverage (U, 6) of filtered samples."""
        velocity_air = relative_to_air(signals.velocity, signals.attitude, signals.wind)
        inputs = np.empty((len(time_ns), len(INPUT_NAMES)))
        inputs_kernel(
            velocity_air, signals.attitude, signals.rates, signals.rotor_speeds, *self._constants, inputs
        )
        evaluation = self.model.evaluate(inputs, self.confidence)
        measured = newton_euler(
            signals.specific_force, signals.rates, signals.angular_acceleration, self._mass, self._inertia
        )
        lower, upper = evaluation.lower, evaluation.upper
        if self._adaptive is not None:
            lower, upper = self._adaptive.step(measured, lower, upper)
        predictions = Predictions(
            time_ns,
            evaluation.predicted,
            lower,
            upper,
            measured,
            evaluation.relative_width,
        )
        return predictions, inputs, evaluation.leverage


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


@njit(cache=True)
def _all_finite(lower: Any, upper: Any, measured: Any, leverage: Any, inputs: Any, finite: Any) -> bool:
    """Mark the samples of which every number is finite; True if all are."""
    everywhere = True
    for i in range(finite.size):
        total = lower[i].sum() + upper[i].sum() + measured[i].sum() + leverage[i].sum() + inputs[i].sum()
        finite[i] = np.isfinite(total)
        everywhere &= finite[i]
    return everywhere
