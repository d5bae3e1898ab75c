# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the live path would have had of a recorded flight: causal states, which err more than smoothed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError
from quadpi_core.flight import MAX_GAP_NS, Recording, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.monitor.pairing import SET_BACK
from quadpi_core.monitor.preparation import Preparation
from quadpi_core.monitor.replay import follow, recorded_flight
from quadpi_core.signals.resample import interpolate, nominal_rate
from quadpi_core.vehicle import Vehicle


class LiveSamples(NamedTuple):
    """Samples as a monitor judges them, on the time grid of a flight.

    Attributes:
        inputs: (N, 19) input vectors.
        wrench: (N, 6) measured, N and Nm, body axes.
        known: (N,) False where the monitor had nothing to judge, or the state had not settled; the rows there
            mean nothing.
    """

    inputs: Array
    wrench: Array
    known: npt.NDArray[np.bool_]


def live_samples(recording: Recording, vehicle: Vehicle, cutoff_hz: float, at_ns: Stamps) -> LiveSamples:
    """Run estimator, pairing and low-pass as a replay does, and take the stamps (N,) of a flight from that.

    Raises:
        LogError: naming what is missing, or if no sample could be judged.
        SignalError: if the estimator never starts, or the cut-off is impossible.
    """
    preparation = Preparation(vehicle, nominal_rate(recording.imu.time_ns), cutoff_hz)
    stamps, rows = [np.empty(0, dtype=np.int64)], [np.empty((0, len(INPUT_NAMES) + 7))]
    for part in follow(recorded_flight(recording), vehicle):
        if part.begin == SET_BACK:
            preparation.reset()
        preparation.retune(part.rate)
        prepared = preparation.step(*part.samples)
        stamps.append(prepared.time_ns[prepared.usable])
        rows.append(np.column_stack((prepared.inputs, prepared.measured, prepared.settled)))
    time_ns, values = np.concatenate(stamps), np.concatenate(rows)
    if len(time_ns) == 0:
        raise LogError(f"{recording.source}: no sample that a monitor could judge")
    values, known = interpolate(time_ns, values, at_ns, MAX_GAP_NS)
    inputs, wrench, settled = np.split(values, [len(INPUT_NAMES), len(INPUT_NAMES) + 6], axis=1)
    known &= settled[:, 0] == 1.0
    return LiveSamples(np.ascontiguousarray(inputs), np.ascontiguousarray(wrench), known)
