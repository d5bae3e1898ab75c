# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that log readers share: stamps from a clock, attitudes of unit length, rotor-speed spikes dropped."""

from __future__ import annotations

import logging

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError
from quadpi_core.flight import RotorSpeedStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.vehicle import Vehicle

STANDARD_GRAVITY = 9.80665
NORM_TOLERANCE = 0.05
SPIKE_SHARE = 0.01

_log = logging.getLogger(__name__)


def stamps_ns(source: str, time: Array, seconds_per_unit: float = 1.0) -> Stamps:
    """Integer nanosecond stamps (N,) of a clock (N,) that counts in units of `seconds_per_unit`.

    Raises:
        LogError: if a time is not finite, or too large to be held as nanoseconds.
    """
    seconds = time * seconds_per_unit
    usable = np.isfinite(seconds) & (np.abs(seconds) < np.iinfo(np.int64).max / 1e9)
    if not np.all(usable):
        index = int(np.argmin(usable))
        raise LogError(f"{source}: sample {index}: the time is not a usable number ({time[index]})")
    return np.round(seconds * 1e9).astype(np.int64)


def unit_attitude(source: str, topic: str, attitude: Array) -> Array:
    """Attitude quaternions (N, 4) scaled to unit length; logs store them rounded.

    Samples that are not finite pass as they are: they are judged with the rest of their stream.

    Raises:
        LogError: naming the sample whose norm is not near 1, for then it is not an attitude.
    """
    norm = np.linalg.norm(attitude, axis=1)
    wrong = np.abs(norm - 1.0) > NORM_TOLERANCE
    if np.any(wrong):
        index = int(np.argmax(wrong))
        raise LogError(
            f"{source}: topic {topic}: sample {index}: the attitude quaternion has norm {norm[index]:.3g}, "
            "expected 1; are the columns or their order right?"
        )
    unit: Array = attitude / norm[:, np.newaxis]
    return unit


def rotor_spikes(stream: RotorSpeedStream, vehicle: Vehicle) -> npt.NDArray[np.bool_]:
    """Samples (N,) in which a rotor is faster than the vehicle allows; infinite is no spike but no speed."""
    fast = (stream.speeds > vehicle.rotor_speed_spike_rad_s) & np.isfinite(stream.speeds)
    spikes: npt.NDArray[np.bool_] = np.any(fast, axis=1)
    return spikes


def drop_rotor_spikes(source: str, stream: RotorSpeedStream, vehicle: Vehicle) -> RotorSpeedStream:
    """The stream without the samples in which a rotor is faster than the vehicle allows, logging how many.

    Electrical speeds over telemetry spike to millions of revolutions now and then. More of them than
    SPIKE_SHARE are no spikes and stay: :func:`quadpi_core.logs.plausibility.check_plausible` refuses them.
    Nor are infinite speeds, which no sensor sends: :meth:`Stream.check` refuses them.
    """
    spike = rotor_spikes(stream, vehicle)
    if not np.any(spike) or spike.mean() > SPIKE_SHARE:
        return stream
    _log.warning(
        "%s: topic %s: dropped %d of %d samples above the vehicle's %.0f rad/s, the first is sample %d",
        source,
        stream.topic,
        spike.sum(),
        len(stream),
        vehicle.rotor_speed_max_rad_s,
        np.argmax(spike),
    )
    return RotorSpeedStream(stream.time_ns[~spike], stream.speeds[~spike])
