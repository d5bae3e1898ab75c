# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The filter over whole streams gives what it gives sample by sample, in the order of arrival."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.errors import SignalError
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_state import Outcome
from test.core.known_flights import feed

RATE = 500.0


def test_one_by_one_equals_the_run_bit_for_bit(noisy_vehicle, simulate_flight):
    recording = simulate_flight(3, duration=4.0).recording
    imu = recording.imu
    keep = np.ones(len(imu), dtype=bool)
    keep[1100:1200] = False  # a pause that resets the filter
    streams = {column.name: getattr(imu, column.name)[keep] for column in fields(imu)}
    streams["angular_velocity"][700, 1] = np.nan
    recording = replace(recording, imu=replace(imu, **streams))
    whole = Ekf(noisy_vehicle, RATE)
    trace = whole.run(recording)

    ekf = Ekf(noisy_vehicle, RATE)
    rows, fused = [], []
    for _, step in feed(ekf, recording):
        state = ekf.state
        fused.append(step.fused.rows.copy())
        rows.append(
            np.concatenate(
                (
                    [state.time_ns],
                    state.position,
                    state.velocity,
                    state.attitude,
                    state.gyro_bias,
                    state.accelerometer_bias,
                    [ekf.delay_s],
                    np.diag(state.covariance),
                    [step.status],
                )
            )
        )
    expected = np.column_stack(
        (
            trace.time_ns,
            trace.position,
            trace.velocity,
            trace.attitude,
            trace.gyro_bias,
            trace.accelerometer_bias,
            trace.delay_s,
            trace.variance,
            trace.status,
        )
    )
    assert np.array_equal(np.array(rows), expected)
    assert np.array_equal(np.concatenate(fused), trace.fused.rows)
    assert ekf.imu_counts == whole.imu_counts
    assert whole.imu_counts[Outcome.RESET] == 1
    assert whole.imu_counts[Outcome.UNUSABLE] == 1
    assert np.max(np.diff(trace.time_ns)) > 1_000_000_000


def test_says_what_it_needs_to_start(noisy_vehicle, simulated):
    recording = simulated.recording
    with pytest.raises(SignalError, match=r"simulated\.bag: topics mocap/pose, .* are missing"):
        Ekf(noisy_vehicle, RATE).run(replace(recording, pose=None))
    later = replace(recording.pose, time_ns=recording.pose.time_ns + 3_600_000_000_000)
    with pytest.raises(SignalError, match=r"never started.*imu spans 0\.000.*mocap/pose 3600\.000"):
        Ekf(noisy_vehicle, RATE).run(replace(recording, pose=later))
