# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs of the model from the topics that live nodes publish, low-passed as the monitor sees them.

The monitor publishes which inputs are outside, not how large all of them are: the page computes them itself,
so that the flight nodes do nothing for it.
"""

from __future__ import annotations

import itertools

import numpy as np

from quadpi_core.errors import LogError, SignalError
from quadpi_core.flight import MAX_GAP_NS, OdometryStream, RotorSpeedStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, aerodynamic_inputs, relative_to_air
from quadpi_core.signals.chain import (
    ATTITUDE,
    CHANNELS,
    RATES,
    ROTOR_SPEEDS,
    VELOCITY,
    WIND,
    make_continuous,
)
from quadpi_core.signals.filters import LowPass, design_low_pass, low_pass, settled_state
from quadpi_core.vehicle import ROTORS, Vehicle

# Stamps from which the rate is measured, before anything is shown.
_RATE_STAMPS = 100
# States that wait for rotor speeds; two seconds at 500 Hz.
_WAITING_MOST = 1000
_STATE = 10


class LiveInputs:
    """Input vectors of one vehicle, from its odometry and rotor speeds.

    Args:
        vehicle: as in its vehicle file.
        cutoff_hz: of the model's low-pass.
    """

    def __init__(self, vehicle: Vehicle, cutoff_hz: float) -> None:
        self.wind = np.zeros(3)
        self._vehicle = vehicle
        self._cutoff_hz = cutoff_hz
        self._design: LowPass | None = None
        self._delays: Array | None = None
        self._attitude = np.zeros(4)
        self._last_ns = 0
        self._time_ns: Stamps = np.empty(0, dtype=np.int64)
        self._states = np.empty((0, _STATE))
        self._rotor_ns: Stamps = np.empty(0, dtype=np.int64)
        self._rotors = np.empty((0, ROTORS))

    def take(self, states: OdometryStream | None, rotors: RotorSpeedStream | None) -> tuple[Stamps, Array]:
        """Take what has come; stamps (K,) and inputs (K, 19) of the states with rotor speeds behind them.

        Raises:
            LogError: for another number of rotors than the vehicle has.
        """
        if rotors is not None:
            if rotors.speeds.shape[1] != ROTORS:
                raise LogError(
                    f"topic rotor_speeds: {rotors.speeds.shape[1]} rotors, vehicle {self._vehicle.name} has "
                    f"{ROTORS}: its inputs are not known"
                )
            self._rotor_ns = np.concatenate((self._rotor_ns, rotors.time_ns))
            self._rotors = np.concatenate((self._rotors, rotors.speeds))
        if states is not None:
            rows = np.concatenate((states.velocity, states.attitude, states.rates), axis=1)
            self._time_ns = np.concatenate((self._time_ns, states.time_ns))
            self._states = np.concatenate((self._states, rows))
        ready = np.empty(0, dtype=np.bool_)
        if len(self._rotor_ns) and self._rate_is_known():
            ready = self._time_ns <= self._rotor_ns[-1]
        if not ready.any():
            self._keep(-_WAITING_MOST)
            return np.empty(0, dtype=np.int64), np.empty((0, len(INPUT_NAMES)))
        time_ns, rows = self._time_ns[ready], self._states[ready]
        self._time_ns, self._states = self._time_ns[~ready], self._states[~ready]
        steps = np.diff(time_ns, prepend=self._last_ns)
        breaks = np.flatnonzero((steps <= 0) | (steps > MAX_GAP_NS))
        inputs = []
        for first, end in itertools.pairwise((0, *breaks.tolist(), len(time_ns))):
            if first in breaks:
                # The low-pass starts again behind a gap.
                self._delays, self._attitude = None, np.zeros(4)
            if end > first:
                inputs.append(self._filtered_inputs(time_ns[first:end], rows[first:end]))
        self._last_ns = int(time_ns[-1])
        kept = self._rotor_ns >= self._last_ns - MAX_GAP_NS
        self._rotor_ns, self._rotors = self._rotor_ns[kept], self._rotors[kept]
        self._keep(-_WAITING_MOST)
        return time_ns, np.concatenate(inputs)

    def _keep(self, first: int) -> None:
        """Let go of what waits for too long."""
        self._time_ns, self._states = self._time_ns[first:], self._states[first:]
        self._rotor_ns, self._rotors = self._rotor_ns[first:], self._rotors[first:]

    def _rate_is_known(self) -> bool:
        if self._design is None and len(self._time_ns) >= _RATE_STAMPS:
            step_ns = float(np.median(np.diff(self._time_ns)))
            try:
                self._design = design_low_pass(self._cutoff_hz, 1e9 / step_ns if step_ns > 0.0 else 0.0)
            except SignalError:
                # Too slow for the low-pass: the monitor predicts nothing either.
                self._time_ns, self._states = self._time_ns[:0], self._states[:0]
        return self._design is not None

    def _filtered_inputs(self, time_ns: Stamps, rows: Array) -> Array:
        assert self._design is not None
        samples = np.zeros((len(time_ns), CHANNELS))
        samples[:, : RATES.stop] = rows
        samples[:, WIND] = self.wind
        order = np.argsort(self._rotor_ns, kind="stable")
        for rotor in range(ROTORS):
            speeds = np.interp(time_ns, self._rotor_ns[order], self._rotors[order, rotor])
            samples[:, ROTOR_SPEEDS.start + rotor] = speeds
        self._attitude = make_continuous(samples[:, ATTITUDE], self._attitude)
        if self._delays is None:
            self._delays = settled_state(self._design, samples[0])
        value, slope = np.empty_like(samples), np.empty_like(samples)
        low_pass(self._design, self._delays, samples, value, slope)
        attitude = value[:, ATTITUDE]
        attitude /= np.sqrt(np.sum(attitude * attitude, axis=1, keepdims=True))
        velocity_air = relative_to_air(value[:, VELOCITY], attitude, value[:, WIND])
        return aerodynamic_inputs(
            velocity_air, attitude, value[:, RATES], value[:, ROTOR_SPEEDS], self._vehicle
        )
