# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""States that repeat, number by number, while the gyro turns: motion capture that froze in flight."""

from __future__ import annotations

import numpy as np

from quadpi_core.findings import Finding
from quadpi_core.flight import ImuStream
from quadpi_core.screening.excerpt import Pose
from quadpi_core.screening.rotors_in_flight import runs_of
from quadpi_core.thresholds import Threshold

FROZEN_S = Threshold(
    "duration of a state that repeats while the gyro turns",
    0.3,
    "s",
    "sound flights repeat position and attitude together for less than 0.1 s",
    "122 real recordings of seven sets and the bundled bags",
)
FROZEN_TURN_RAD = Threshold(
    "turn by the gyro while a state repeats",
    0.05,
    "rad",
    "a gyro at rest drifts by less in a second; in 1.5 s of a figure-eight it turns by 0.16 rad at least",
    "imrc_brushless",
)


def without_repeats(state: Pose, imu: ImuStream) -> tuple[Pose, Finding | None]:
    """A state without samples that repeat for FROZEN_S and longer while the gyro turns, and their finding.

    Args:
        state: with finite values and increasing stamps.
        imu: likewise.
    """
    if len(state) < 2 or len(imu) < 2:
        return state, None
    same = np.all(np.diff(np.hstack((state.position, state.attitude)), axis=0) == 0.0, axis=1)
    time_s, imu_s = ((stream.time_ns - imu.time_ns[0]) * 1e-9 for stream in (state, imu))
    angle = np.zeros_like(imu.angular_velocity)
    angle[1:] = np.cumsum(imu.angular_velocity[1:] * np.diff(imu_s)[:, np.newaxis], axis=0)
    frozen: list[tuple[float, float, float]] = []
    usable = np.ones(len(state), dtype=np.bool_)
    for first, last in runs_of(same):
        begin_s, end_s = time_s[[first, last]].tolist()
        within = angle[slice(*np.searchsorted(imu_s, (begin_s, end_s)))]
        turn = float(np.ptp(within, axis=0).max()) if len(within) else 0.0
        # A gyro that drifts turns steadily, and slowly.
        least = FROZEN_TURN_RAD.value * max(1.0, end_s - begin_s)
        if end_s - begin_s >= FROZEN_S.value and turn >= least:
            frozen.append((begin_s, end_s, turn))
            usable[first + 1 : last + 1] = False
    if not frozen:
        return state, None
    begin_s, end_s, turn = max(frozen, key=lambda one: one[1] - one[0])
    whole_s = sum(end - begin for begin, end, _ in frozen)
    text = (
        f"position and attitude repeat from {begin_s:.2f} to {end_s:.2f} s while the gyro turns by "
        f"{np.degrees(turn):.0f}°, and so for {whole_s:.1f} s in all: the tracking is lost or its driver "
        "repeats the last pose; leave these samples out"
    )
    return state.take(usable), Finding("frozen state", state.topic, text)
