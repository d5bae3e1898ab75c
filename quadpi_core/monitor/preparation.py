# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From sensor samples to filtered inputs and the measured wrench: what models of one cut-off share."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, inputs_kernel, relative_to_air, vehicle_constants
from quadpi_core.monitor.faults import FaultFinder
from quadpi_core.signals.chain import FilteredSignals, SignalChain
from quadpi_core.signals.wrench import newton_euler
from quadpi_core.vehicle import Vehicle

# The arguments of `Preparation.step` after the stamps, in their order.
Signals: TypeAlias = tuple[Array, ...]


class Prepared(NamedTuple):
    """K samples, U of them usable.

    Attributes:
        time_ns: (K,) stamps.
        usable: (K,) False for a sample that cannot be judged.
        inputs: (U, 19) input vectors of the usable samples.
        measured: (U, 6) their measured wrench, N and Nm, body axes.
        velocity: (U, 3) their velocity over ground, m/s, body axes.
        faults: (K,) what is wrong, bits of :mod:`quadpi_core.monitor.faults`.
    """

    time_ns: Stamps
    usable: npt.NDArray[np.bool_]
    inputs: Array
    measured: Array
    velocity: Array
    faults: npt.NDArray[np.int64]


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
        self._finder = FaultFinder(vehicle, rate_hz)

    def reset(self) -> None:
        """Forget the past: as after construction."""
        self._chain.reset()
        self._finder.reset()

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
        usable, restart, faults, used, restarts = self._finder.step(time_ns, *signals)
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
        return Prepared(time_ns, usable, inputs, measured, filtered.velocity, faults)

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
