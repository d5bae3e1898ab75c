# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""When the rotors carry the vehicle, and whether one of them reads the same speed for long meanwhile."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from quadpi_core.findings import Finding
from quadpi_core.flight import Recording
from quadpi_core.frames import Array
from quadpi_core.thresholds import CONVENTION, Threshold

# Share of the weight from which on the rotors carry the vehicle.
_CARRYING_SHARE = 0.5
STUCK_RAD_S = Threshold(
    "extent of a stuck rotor speed",
    1e-3,
    "rad/s",
    "below the resolution of any sensor: a speed that changes no more is not measured",
    CONVENTION,
)
STUCK_S = Threshold(
    "duration of a stuck rotor speed in flight",
    0.5,
    "s",
    "sound flights read the same for 0.11 s at most, those with a sensor that fails for 0.6 s and more",
    "91 real recordings of five vehicles and the bundled bags; four of them with such a sensor",
)


def carrying(speeds: Array, lift: Array, gravity_m_s2: float) -> npt.NDArray[np.bool_]:
    """Where k Σω² exceeds half of the weight, with k fitted to the specific force of all samples.

    So neither a hover before a fast flight nor a long time on the ground shifts the threshold.

    Args:
        speeds: (N, rotors) rad/s.
        lift: (N,) specific force upward in body axes, m/s².
        gravity_m_s2: acceleration of gravity.
    """
    squares = np.square(speeds).sum(axis=1)
    thrust_m_s2 = squares * (lift @ squares) / max(squares @ squares, 1.0)
    return np.asarray(thrust_m_s2 > _CARRYING_SHARE * gravity_m_s2)


def stuck_rotors(recording: Recording, gravity_m_s2: float) -> Iterator[Finding]:
    """Rotors that read the same speed, most often 0, for STUCK_S and longer while all carry the vehicle.

    Args:
        recording: with finite values and increasing stamps.
        gravity_m_s2: acceleration of gravity.
    """
    rotors, imu = recording.rotor_speeds, recording.imu
    if rotors is None or len(rotors) < 2 or len(imu) == 0:
        return
    time_s = (rotors.time_ns - imu.time_ns[0]) * 1e-9
    lift = np.interp(time_s, (imu.time_ns - imu.time_ns[0]) * 1e-9, -imu.specific_force[:, 2])
    flying = carrying(rotors.speeds, lift, gravity_m_s2)
    same = np.abs(np.diff(rotors.speeds, axis=0)) < STUCK_RAD_S.value
    same &= (flying[1:] & flying[:-1])[:, np.newaxis]
    for rotor, column in enumerate(same.T):
        # Samples that a run of equal readings begins and ends with.
        begin, end = np.flatnonzero(np.diff(column, prepend=False, append=False)).reshape(-1, 2).T
        seconds = time_s[end] - time_s[begin]
        if not np.any(seconds >= STUCK_S.value):
            continue
        longest = int(np.argmax(seconds))
        whole = float(seconds[seconds >= STUCK_S.value].sum())
        yield Finding(
            "stuck rotor",
            rotors.topic,
            f"rotor {rotor + 1} reads {rotors.speeds[begin[longest], rotor]:.4g} rad/s from "
            f"{time_s[begin[longest]]:.2f} to {time_s[end[longest]]:.2f} s in flight, without a change, "
            f"and so for {whole:.1f} s in all: its sensor fails; leave this flight out",
            leave_out=True,
        )
