# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The filter over whole streams gives what it gives sample by sample, in the order of arrival."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core import frames, reading_options
from quadpi_core.core import compiled
from quadpi_core.errors import SignalError
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import (
    FUSED,
    FusedSamples,
    Inputs,
    Spans,
    Tape,
    imu_records,
    in_order_of_arrival,
    never_started,
    smooth,
    with_gyro_faults,
)
from quadpi_core.estimator.filter_state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    BODY_VELOCITY,
    DELAY,
    ERROR_STATES,
    ESTIMATE,
    FILTER,
    GYRO_BIAS,
    POSE,
    POSITION,
    VELOCITY,
    WORLD_VELOCITY,
    Outcome,
    State,
)
from quadpi_core.flight import ImuStream, Recording, TwistStream
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.payloads import ODOMETRY_VALUES
from quadpi_core.messages.sensor_messages import ODOMETRY, pack_odometry
from quadpi_core.reading_options import by_arrival, split_recording
from quadpi_core.records import SPECIFIC_FORCE_MAX_M_S2
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


GYRO_NOISE = 0.02


def make_state(rng: np.random.Generator) -> State:
    root = 0.02 * rng.standard_normal((ERROR_STATES, ERROR_STATES))
    estimate = np.zeros(1, ESTIMATE)
    for name in ("rates", "specific_force", "position", "velocity", "attitude"):
        estimate[name] = rng.standard_normal(estimate[name].shape)
    estimate["gyro_bias"], estimate["accelerometer_bias"] = rng.standard_normal((2, 1, 3))
    estimate["velocity"] *= 10.0
    estimate["attitude"] /= np.linalg.norm(estimate["attitude"])
    estimate["covariance"] = root @ root.T
    return State(estimate[0])


def fused(state: State) -> FusedSamples:
    sample, memory = np.empty(1, FUSED), np.zeros(1, FILTER)
    memory["noise"]["rates"] = GYRO_NOISE**2
    compiled.fill_newest(memory, np.array([state.rows]), sample)
    return FusedSamples.from_rows(sample)


def test_imu_is_corrected_and_velocity_in_body_axes() -> None:
    state = make_state(np.random.default_rng(3))
    sample = fused(state)
    np.testing.assert_allclose(sample.imu.angular_velocity[0], state.rates - state.gyro_bias)
    np.testing.assert_allclose(sample.imu.specific_force[0], state.specific_force - state.accelerometer_bias)
    np.testing.assert_allclose(
        sample.odometry.velocity[0], rotate_world_to_body(state.attitude, state.velocity), rtol=1e-12
    )
    state.position[:] = np.nan
    assert np.isfinite(sample.odometry.position).all()


def test_odometry_is_that_of_the_states() -> None:
    sample = fused(make_state(np.random.default_rng(5)))
    values = np.empty((1, ODOMETRY_VALUES))
    compiled.fill_odometry(sample.rows, values)
    packed = pack_odometry(sample.odometry, sample.pose_covariance, sample.twist_covariance)
    np.testing.assert_array_equal(codec(ODOMETRY).decode_stamped(packed)[1], values)


def test_covariances_match_the_spread_of_perturbed_states() -> None:
    rng = np.random.default_rng(4)
    state = make_state(rng)
    errors = rng.multivariate_normal(np.zeros(ERROR_STATES), state.covariance, 20_000)
    gyro_errors = GYRO_NOISE * rng.standard_normal((len(errors), 3))
    pose, twist = np.empty((len(errors), 6)), np.empty((len(errors), 6))
    for row, (error, gyro_error) in enumerate(zip(errors, gyro_errors, strict=True)):
        turned = frames.product(state.attitude, frames.from_rotation_vector(error[ATTITUDE]))
        world_turn = frames.product(turned, frames.inverse(state.attitude))
        pose[row] = *error[POSITION], *frames.to_rotation_vector(world_turn)
        twist[row, :3] = rotate_world_to_body(turned, state.velocity + error[VELOCITY])
        twist[row, 3:] = gyro_error - error[GYRO_BIAS]
    sample = fused(state)
    assert_close(sample.pose_covariance[0], np.cov(pose.T))
    assert_close(sample.twist_covariance[0], np.cov(twist.T))


def assert_close(actual: Array, expected: Array) -> None:
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(actual / scale, expected / scale, atol=0.06)


def test_a_gyro_that_cannot_be_shows_in_the_specific_force() -> None:
    rates = np.zeros((4, 3))
    rates[1, 2], rates[2, 0], rates[3, 1] = np.nan, -71.0, 69.0
    force = np.tile([0.0, 0.0, -9.8], (4, 1))
    shown = with_gyro_faults(ImuStream(np.arange(4), rates, force)).specific_force
    np.testing.assert_array_equal(shown[[0, 3]], force[[0, 3]])
    assert np.isnan(shown[1, 2])
    assert np.isfinite(shown[2]).all()
    assert np.abs(shown[2]).max() > SPECIFIC_FORCE_MAX_M_S2


# Events of a tape.
STEP, SCALAR_CORRECTION = 0, 1


def dense(transition):
    """The matrix (16, 16) that a transition stands for."""
    matrix = np.eye(ERROR_STATES)
    dt = transition["dt"]
    matrix[POSITION, VELOCITY] = dt * np.eye(3)
    matrix[VELOCITY, ATTITUDE] = transition["velocity_by_attitude"]
    matrix[VELOCITY, ACCELEROMETER_BIAS] = transition["velocity_by_accelerometer_bias"]
    matrix[ATTITUDE, ATTITUDE] = transition["attitude_by_attitude"]
    matrix[ATTITUDE, GYRO_BIAS] = -dt * np.eye(3)
    return matrix


def process_noise(noise, dt):
    growth = np.zeros(ERROR_STATES)
    growth[VELOCITY], growth[ATTITUDE] = noise["accelerometer"], noise["gyro"]
    growth[GYRO_BIAS], growth[ACCELEROMETER_BIAS] = noise["gyro_bias"], noise["accelerometer_bias"]
    growth[15] = noise["delay"]
    return dt * np.diag(growth)


def textbook(tape, covariance, noise):
    """Rauch, Tung and Striebel with dense matrices: smoothed errors and variances at the estimates."""
    steps, transitions, scalars = [], iter(tape.steps), iter(tape.scalars)
    for event in tape.events[: tape.length["events"][0]]:
        if event == STEP:
            transition = next(transitions)
            f = dense(transition)
            predicted = f @ covariance @ f.T + process_noise(noise, transition["dt"])
            steps.append(("step", covariance @ f.T @ np.linalg.inv(predicted), covariance, predicted))
            covariance = predicted
        elif event == SCALAR_CORRECTION:
            scalar = next(scalars)
            innovation, expected = scalar["innovation"], scalar["innovation_variance"]
            gain = covariance @ scalar["jacobian"] / expected
            np.testing.assert_allclose(gain, scalar["gain"], rtol=1e-5, atol=1e-9)
            covariance = covariance - np.outer(gain, gain) * expected
            steps.append(("scalar", gain * innovation, None, None))
        else:
            steps.append(("estimate", None, None, None))
    error, smoothed, results = np.zeros(ERROR_STATES), covariance, []
    for kind, value, before, predicted in reversed(steps):
        if kind == "step":
            error = value @ error
            smoothed = before + value @ (smoothed - predicted) @ value.T
        elif kind == "scalar":
            error = error + value
        else:
            results.append((error, np.diag(smoothed)))
    errors, variances = zip(*reversed(results), strict=True)
    return np.array(errors), np.array(variances)


@pytest.fixture
def brief(simulate_flight) -> Recording:
    return simulate_flight(6, duration=2.2).recording


def test_it_is_the_smoother_of_the_textbook(noisy_vehicle, brief):
    (segment,) = Ekf(noisy_vehicle, RATE).segments(brief)
    inputs = Inputs(imu_records(brief.imu)[segment.samples], segment.journal, segment.noise)
    count = len(segment.samples)
    tape = Tape.empty(count, len(segment.journal))
    assert compiled.forward(inputs, segment.initial.estimate.copy(), 0, count, 0, tape) == len(
        segment.journal
    )
    errors, variances = textbook(tape, segment.initial.estimate["covariance"][0], segment.noise[0])

    smoothed = smooth(brief.imu, Ekf(noisy_vehicle, RATE).segments(brief))
    live = slice(segment.first, None)
    expected, errors = tape.estimates[live], errors[live]
    np.testing.assert_allclose(smoothed.velocity, expected["velocity"] + errors[:, VELOCITY], atol=1e-6)
    np.testing.assert_allclose(smoothed.gyro_bias, expected["gyro_bias"] + errors[:, GYRO_BIAS], atol=1e-7)
    np.testing.assert_allclose(smoothed.delay_s, expected["delay"] + errors[:, DELAY], atol=1e-7)
    np.testing.assert_allclose(smoothed.variance, variances[live], rtol=1e-4)


def test_the_last_estimate_is_that_of_the_filter_in_the_order_of_instants(noisy_vehicle, brief):
    smoothed = smooth(brief.imu, Ekf(noisy_vehicle, RATE).segments(brief))
    trace = Ekf(noisy_vehicle, RATE).run(brief)
    assert np.array_equal(smoothed.time_ns, trace.time_ns)
    np.testing.assert_allclose(smoothed.velocity[-1], trace.velocity[-1], rtol=1e-12)
    np.testing.assert_allclose(smoothed.variance[-1], trace.variance[-1], rtol=1e-9)


def test_errors_are_smaller_and_the_beginning_is_as_good_as_the_middle(noisy_vehicle, simulated):
    recording, true = simulated.recording, simulated.truth
    smoothed = smooth(recording.imu, Ekf(noisy_vehicle, RATE).segments(recording))
    trace = Ekf(noisy_vehicle, RATE).run(recording)
    index = np.searchsorted(recording.imu.time_ns, trace.time_ns)
    expected = rotate_world_to_body(true.attitude[index], true.velocity[index])

    def error(velocity, rows):
        return np.sqrt(np.mean((velocity[rows] - expected[rows]) ** 2))

    whole = slice(None)
    assert error(smoothed.velocity_body, whole) < 0.5 * error(trace.velocity_body, whole)
    assert error(smoothed.velocity_body, slice(0, 200)) < 2.0 * error(smoothed.velocity_body, whole)
    scaled = (smoothed.velocity - true.velocity[index]) ** 2 / smoothed.variance[:, VELOCITY]
    assert 0.4 < np.mean(scaled) < 1.8


def test_a_pause_of_the_imu_makes_two_segments(noisy_vehicle, simulated):
    imu = simulated.recording.imu
    keep = np.ones(len(imu), dtype=bool)
    keep[2000:2100] = False
    parts = {column.name: getattr(imu, column.name)[keep] for column in fields(imu)}
    recording = replace(simulated.recording, imu=replace(imu, **parts))
    smoothed = smooth(recording.imu, Ekf(noisy_vehicle, RATE).segments(recording))
    trace = Ekf(noisy_vehicle, RATE).run(recording)
    assert np.array_equal(smoothed.time_ns, trace.time_ns)
    index = np.searchsorted(imu.time_ns, smoothed.time_ns)
    assert np.max(np.abs(smoothed.velocity - simulated.truth.velocity[index])) < 0.1


def test_a_delay_other_than_that_of_the_filter_does_not_run_away(noisy_vehicle, simulated):
    """By 4 ms at the start, as rounding once grew to: by the end a tenth of it is left."""
    (segment,) = Ekf(noisy_vehicle, RATE).segments(simulated.recording)
    other = segment.initial.estimate.copy()
    other["delay"] += 0.004
    late = segment._replace(initial=segment.initial._replace(estimate=other))
    inputs = Inputs(imu_records(simulated.recording.imu)[segment.samples], segment.journal, segment.noise)
    passes = []
    for begun in (segment, late):
        estimate = begun.initial.estimate.copy()
        compiled.forward(inputs, estimate, 0, len(segment.samples), 0, Tape.empty(0, 0))
        passes.append(estimate)
    one, two = passes
    assert abs(one["delay"][0] - two["delay"][0]) < 4e-4
    np.testing.assert_allclose(one["gyro_bias"], two["gyro_bias"], atol=1e-3)
    np.testing.assert_allclose(one["position"], two["position"], atol=1e-3)
