# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The filter over whole streams gives what it gives sample by sample, in the order of arrival."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core import reading_options
from quadpi_core.errors import SignalError
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import Spans, in_order_of_arrival, never_started
from quadpi_core.estimator.filter_state import BODY_VELOCITY, POSE, WORLD_VELOCITY, Outcome
from quadpi_core.flight import TwistStream
from quadpi_core.reading_options import by_arrival, split_recording
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


def seen(simulated, every: int = 3):
    """A recording with poses and with velocities whose arrival the log knows, later than their stamps."""
    recording, true = simulated.recording, simulated.truth
    imu = recording.imu
    twist = TwistStream(imu.time_ns[::every], true.velocity[::every], np.arange(len(imu))[::every] % 2 == 0)
    late = np.minimum(np.arange(len(imu))[::every] + 5, len(imu))
    return replace(recording, twist=twist, arrivals={twist.topic: late})


def test_samples_are_taken_in_the_order_of_their_arrival(simulate_flight):
    recording = seen(simulate_flight(2, duration=0.4))
    imu, pose, twist = recording.imu, recording.pose, recording.twist
    known = recording.arrivals[twist.topic]
    events = [(sum(imu.time_ns <= stamp), 0, k) for k, stamp in enumerate(pose.time_ns)]
    events += [(int(known[k]), 1, k) for k in range(len(twist))]
    arrivals = in_order_of_arrival(recording)
    np.testing.assert_array_equal(arrivals.samples["rates"], imu.angular_velocity)
    for measurement, after, (count, source, k) in zip(
        arrivals.measurements, arrivals.after, sorted(events), strict=True
    ):
        assert after == count
        if source == 0:
            assert measurement["kind"] == POSE
            np.testing.assert_array_equal(measurement["vector"], pose.position[k])
            np.testing.assert_array_equal(measurement["attitude"], pose.attitude[k])
        else:
            assert measurement["kind"] == (BODY_VELOCITY if k * 3 % 2 == 0 else WORLD_VELOCITY)
            np.testing.assert_array_equal(measurement["vector"], twist.velocity[k])


def test_blocks_of_any_length_give_the_same_estimates_and_segments(
    noisy_vehicle, simulate_flight, monkeypatch
):
    recording = seen(simulate_flight(3, duration=3.4))
    keep = np.ones(len(recording.imu), dtype=bool)
    keep[800:860] = False  # a pause that resets the filter
    recording = replace(recording, imu=recording.imu.take(keep), arrivals={})
    whole = Ekf(noisy_vehicle, RATE).run(recording)
    segments = Ekf(noisy_vehicle, RATE).segments(recording)
    assert len(segments) == 2
    monkeypatch.setattr(reading_options, "BLOCK_SAMPLES", 37)
    ekf = Ekf(noisy_vehicle, RATE)
    ekf.log_segments(recording)
    blocks = [ekf.take(block) for block in by_arrival(split_recording(recording))]
    for name in ("position", "attitude", "variance", "status"):
        parts = [getattr(block, name) for block in blocks]
        np.testing.assert_array_equal(np.concatenate(parts), getattr(whole, name))
    np.testing.assert_array_equal(np.concatenate([block.fused.rows for block in blocks]), whole.fused.rows)
    for part, expected in zip(ekf.logged_segments(), segments, strict=True):
        np.testing.assert_array_equal(part.samples, expected.samples)
        np.testing.assert_array_equal(part.journal, expected.journal)
        assert (part.first, part.rate_hz) == (expected.first, expected.rate_hz)


def test_the_error_of_a_filter_that_never_starts_tells_the_spans_of_all_blocks(simulated):
    blocks = list(split_recording(simulated.recording))
    spans = Spans()
    for block in (replace(blocks[0], imu=blocks[0].imu.take(slice(0, 0))), *blocks):
        spans = spans.extended(block)
    imu, pose = simulated.recording.imu, simulated.recording.pose
    assert spans == Spans((imu.time_ns[0], imu.time_ns[-1]), (pose.time_ns[0], pose.time_ns[-1]), pose.topic)
    assert "imu spans 0.000 to 7.998 s, mocap/pose 0.000 to 7.992 s" in str(never_started("a.bag", spans))
    assert "imu spans no time" in str(never_started("a.bag", Spans()))
