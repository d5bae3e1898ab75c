# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From sensor samples to filtered inputs and the measured wrench: what models of one cut-off share."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.estimator.imu_rate import RATE_BEFORE_HZ, ImuRate
from quadpi_core.flight import AXES, NO_STAMP, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, inputs_kernel, relative_to_air, vehicle_constants
from quadpi_core.monitor.data_quality import RATE_DIFFERS, RATE_LOW, RATE_UNKNOWN, FaultMemory, judge
from quadpi_core.signals.chain import (
    ATTITUDE,
    CHANNELS,
    RATES,
    ROTOR_SPEEDS,
    SPECIFIC_FORCE,
    VELOCITY,
    WIND,
    ChainMemory,
    filter_sample,
    forget,
)
from quadpi_core.signals.filters import LowPass, Section, design_low_pass
from quadpi_core.signals.wrench import newton_euler
from quadpi_core.vehicle import Vehicle

# After a state begins or comes back, its accelerometer bias is still being found: measured forces then leave
# their intervals up to ten times as often (docs/alarm.md).
SETTLE_NS = 1_000_000_000
# Where the numbers of the low-pass stand: coefficients, rate (0: none fits), fault where no rate fits.
_DESIGN_HZ, _FAULT, _LOW_PASS_SIZE = 6, 7, 8


class Prepared(NamedTuple):
    """K samples, U of them usable.

    Attributes:
        time_ns: (K,) stamps.
        usable: (K,) False for a sample that cannot be judged.
        inputs: (U, 19) input vectors of the usable samples.
        measured: (U, 6) their measured wrench, N and Nm, body axes.
        velocity: (U, 3) their velocity over ground, m/s, body axes.
        faults: (K,) what is wrong, bits of :mod:`quadpi_core.monitor.data_quality`.
        settled: (U,) False for usable samples in the first :data:`SETTLE_NS` after the first one, or after
            more than `MAX_GAP_NS` without any.
    """

    time_ns: Stamps
    usable: npt.NDArray[np.bool_]
    inputs: Array
    measured: Array
    velocity: Array
    faults: npt.NDArray[np.int64]
    settled: npt.NDArray[np.bool_]


class Preparation:
    """Judges and filters the samples of one vehicle; memory and time per sample are constant.

    Args:
        vehicle: as in its vehicle file.
        rate_hz: sample rate of the IMU; None until :meth:`retune` says it.
        cutoff_hz: of the low-pass.

    Raises:
        SignalError: if the sample rate is too low for the cut-off.
    """

    def __init__(self, vehicle: Vehicle, rate_hz: float | None, cutoff_hz: float) -> None:
        self._cutoff_hz = cutoff_hz
        self._rate: ImuRate | None = None
        self._low_pass = np.zeros(_LOW_PASS_SIZE)
        self._faults = FaultMemory.empty(vehicle, rate_hz or RATE_BEFORE_HZ)
        self._chain = ChainMemory.empty()
        self._begun_ns = np.array([NO_STAMP])
        self.retune(ImuRate(rate_hz or 0.0))
        self._known = (
            self._low_pass,
            *(*vehicle_constants(vehicle), vehicle.mass_kg, vehicle.inertia),
            *self._faults,
            *self._chain,
            self._begun_ns,
        )

    def reset(self) -> None:
        """Forget the past: as after construction."""
        self._faults.forget()
        forget(self._chain)

    def retune(self, rate: ImuRate) -> None:
        """Go on with samples of another rate: the low-pass starts anew. Without one, no sample is usable.

        Raises:
            SignalError: if the rate is too low for the cut-off; then no sample is usable either.
        """
        if rate == self._rate:
            return
        self._rate = rate
        forget(self._chain)
        self._low_pass[_DESIGN_HZ] = 0.0
        self._low_pass[_FAULT] = RATE_DIFFERS if rate.differs else RATE_UNKNOWN
        if rate.filter_hz > 0.0:
            self._low_pass[_FAULT] = RATE_LOW
            design = design_low_pass(self._cutoff_hz, rate.filter_hz)
            self._low_pass[:_FAULT] = (*design.first, *design.second, design.rate_hz)
            self._faults.retune(rate.filter_hz)

    def step(self, time_ns: Stamps, values: Array) -> Prepared:
        """Take K samples; see :meth:`quadpi_core.monitor.Monitor.step`."""
        count = len(time_ns)
        prepared = Prepared(
            time_ns,
            np.empty(count, dtype=np.bool_),
            np.empty((count, len(INPUT_NAMES))),
            np.empty((count, len(AXES))),
            np.empty((count, 3)),
            np.empty(count, dtype=np.int64),
            np.empty(count, dtype=np.bool_),
        )
        used = _prepare(values, *self._known, *prepared)
        if used == count:
            return prepared
        return prepared._replace(
            inputs=prepared.inputs[:used],
            measured=prepared.measured[:used],
            velocity=prepared.velocity[:used],
            settled=prepared.settled[:used],
        )


# Arrays one by one: a tuple of them costs twice as much to hand over.
@njit(cache=True)
def _prepare(
    values: Any,
    low_pass: Any,
    control_signs: Any,
    rotor_radius: float,
    hover_induced_velocity: float,
    mass: float,
    inertia: Any,
    limits: Any,
    spins: Any,
    previous_ns: Any,
    state: Any,
    delays: Any,
    last_attitude: Any,
    started: Any,
    begun_ns: Any,
    time_ns: Any,
    usable: Any,
    inputs: Any,
    measured: Any,
    velocity: Any,
    faults: Any,
    settled: Any,
) -> int:
    """Judge and filter samples (K, 20); the number of usable ones, whose rows are filled."""
    design = LowPass(
        Section(low_pass[0], low_pass[1], low_pass[2]),
        Section(low_pass[3], low_pass[4], low_pass[5]),
        low_pass[_DESIGN_HZ],
    )
    memory, chain = (
        FaultMemory(limits, spins, previous_ns, state),
        ChainMemory(delays, last_attitude, started),
    )
    used = 0
    value, slope = np.empty((1, CHANNELS)), np.empty((1, CHANNELS))
    for i in range(values.shape[0]):
        faults[i], usable[i], jump = judge(time_ns[i], values[i], memory)
        if low_pass[_DESIGN_HZ] == 0.0:
            # Of a sample that lacks more, the rest says why.
            faults[i] |= np.int64(low_pass[_FAULT]) if usable[i] else 0
            usable[i] = False
        if not usable[i]:
            continue
        if jump:
            forget(chain)
        if started[0] == 0.0:
            begun_ns[0] = time_ns[i]
        settled[used] = time_ns[i] - begun_ns[0] >= SETTLE_NS
        filter_sample(design, chain, values[i], value[0], slope[0])
        attitude, rates = value[:, ATTITUDE], value[:, RATES]
        row = slice(used, used + 1)
        inputs_kernel(
            relative_to_air(value[:, VELOCITY], attitude, value[:, WIND]),
            attitude,
            rates,
            value[:, ROTOR_SPEEDS],
            control_signs,
            rotor_radius,
            hover_induced_velocity,
            inputs[row],
        )
        measured[row] = newton_euler(value[:, SPECIFIC_FORCE], rates, slope[:, RATES], mass, inertia)
        velocity[used] = value[0, VELOCITY]
        used += 1
    return used
