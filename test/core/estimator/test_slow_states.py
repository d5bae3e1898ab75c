# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""States of 1 to 10 Hz correct the filter: noise stated, learned, or of a part that is not measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core import frames
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.fusion import fuse
from quadpi_core.estimator.slow_states import (
    VelocityRate,
    with_slow_state,
    with_slow_states,
    with_velocity_rate,
)
from quadpi_core.flight import NOT_MEASURED, Flight, OdometryStream, Recording, TwistStream
from quadpi_core.logs import read_recording
from quadpi_core.reading_options import split_recording
from quadpi_core.screening.flight_runs import parts_without_pause
from quadpi_core.vehicle import Vehicle
from test.core.flights_by_gps import state_by_gps

BEBOP = Vehicle.load("bebop2")
BAG = Path(__file__).parents[3] / "bags" / "train_1.mcap"
GPS = np.array([1.0, 0.035, 0.1])


@pytest.fixture(scope="module")
def recording() -> Recording:
    return read_recording(BAG, BEBOP)


@pytest.fixture(scope="module")
def full(recording) -> Flight:
    return fuse(recording, BEBOP, 30.0)


def with_gps(recording: Recording, full: Flight, rate_hz: float = 5.0, deviation: object = GPS) -> Recording:
    """A state as of GPS and an autopilot in the place of motion capture."""
    return state_by_gps(recording, full, np.random.default_rng(3), GPS, rate_hz, deviation)


def velocity_error(recording: Recording, full: Flight) -> np.ndarray:
    found = fuse(recording, BEBOP, 30.0)
    _, mine, theirs = np.intersect1d(found.stamps_ns, full.stamps_ns, return_indices=True)
    assert len(mine) > 0.8 * len(full)
    return np.sqrt(np.mean(np.square(found.velocity[mine] - full.velocity[theirs]), axis=0))


@pytest.mark.parametrize(("rate_hz", "most"), [(1.0, 0.15), (5.0, 0.08), (10.0, 0.07)])
def test_a_slow_state_gives_the_velocity_of_motion_capture(recording, full, rate_hz, most):
    slow = with_gps(recording, full, rate_hz)
    assert parts_without_pause(slow) == [slow]
    corrected = with_slow_state(slow, BEBOP)
    assert corrected.odometry is None
    assert velocity_error(corrected, full).max() < most


def test_noise_that_nothing_tells_is_learned(recording, full):
    corrected = with_slow_state(with_gps(recording, full, deviation=0.0), BEBOP)
    assert corrected.pose.deviation[0] == pytest.approx(GPS[:2], rel=0.3)
    assert corrected.twist.deviation[0] == pytest.approx(GPS[2], rel=0.3)
    noise = replace(BEBOP.noise, state_position_m=2.0, state_attitude_rad=0.1, state_velocity_m_s=0.3)
    stated = with_slow_state(with_gps(recording, full, deviation=0.0), replace(BEBOP, noise=noise))
    assert stated.pose.deviation[0] == pytest.approx([2.0, 0.1])
    assert stated.twist.deviation[0] == 0.3


@pytest.mark.parametrize("lacking", [[2], [0, 2]])
def test_noise_is_learned_of_the_parts_that_are_measured(recording, full, lacking):
    deviation = np.zeros(3)
    deviation[lacking] = NOT_MEASURED
    corrected = with_slow_state(with_gps(recording, full, deviation=deviation), BEBOP)
    told = corrected.pose.deviation[0]
    assert told[1] == pytest.approx(GPS[1], rel=1.0)
    assert (corrected.twist is None) == (0 not in lacking)
    assert told[0] == NOT_MEASURED if 0 in lacking else told[0] == pytest.approx(GPS[0], rel=1.0)


def test_the_covariance_holds_what_the_estimate_errs_by(recording, full):
    trace = Ekf(BEBOP).run(with_slow_state(with_gps(recording, full), BEBOP))
    _, mine, theirs = np.intersect1d(trace.time_ns, full.stamps_ns, return_indices=True)
    odometry = trace.fused.odometry
    error = odometry.velocity[mine] - full.velocity[theirs]
    variance = np.einsum("kii->ki", trace.fused.twist_covariance[mine])[:, :3]
    share = np.mean(np.square(error) / variance)
    assert 0.4 < share < 2.0


@pytest.mark.parametrize("part", [0, 1])
def test_a_part_that_is_not_measured_is_not_used(recording, full, part):
    deviation = GPS.copy()
    deviation[part] = NOT_MEASURED
    slow = with_gps(recording, full, deviation=deviation)
    if part == 1:
        slow.odometry.attitude[:] = [1.0, 0.0, 0.0, 0.0]
        # As of a receiver: what it says of the velocity is in the world.
        moving = frames.rotate_body_to_world(full.attitude, full.velocity)
        rows = np.isin(full.stamps_ns, slow.odometry.time_ns)
        slow.odometry.velocity[:] = moving[rows]
    else:
        slow.odometry.position[:] = 9.0
    corrected = with_slow_state(slow, BEBOP)
    assert velocity_error(corrected, full)[2] < 0.25


def test_an_attitude_alone_is_of_a_vehicle_that_may_move(recording, full):
    deviation = [NOT_MEASURED, GPS[1], NOT_MEASURED]
    fast = with_gps(recording, full, 50.0, deviation)
    corrected = with_slow_state(fast, BEBOP)
    assert set(corrected.twist.deviation) == {2.0}
    trace = Ekf(BEBOP).run(corrected)
    unsure = np.sqrt(np.median(np.einsum("kii->ki", trace.fused.twist_covariance)[:, :2]))
    assert 0.3 < unsure < 2.0


def test_attitudes_alone_with_a_pause_rise_and_keep_when_all_arrived(recording, full):
    fast = with_gps(recording, full, 50.0, [NOT_MEASURED, GPS[1], NOT_MEASURED])
    seconds = 1e-9 * (fast.odometry.time_ns - fast.odometry.time_ns[0])
    states = fast.odometry.take((seconds < 4.0) | (seconds > 7.0))
    arrived = np.searchsorted(fast.imu.time_ns, states.time_ns) + 3
    rotors = np.arange(len(fast.rotor_speeds))
    arrivals = {OdometryStream.topic: arrived, fast.rotor_speeds.topic: rotors}
    paused = replace(fast, odometry=states, arrivals=arrivals)
    corrected = with_slow_state(paused, BEBOP)
    assert np.all(np.diff(corrected.twist.time_ns) > 0)
    assert np.all(np.diff(corrected.twist.velocity[:, 0]) != 0.0)
    assert np.array_equal(corrected.arrivals_of(corrected.pose), arrived)
    assert np.all(np.isin(corrected.arrivals_of(corrected.twist), arrived))
    assert np.array_equal(corrected.arrivals_of(corrected.rotor_speeds), rotors)


def test_one_state_that_lacks_a_part_does_not_decide_for_the_flight(recording, full):
    slow = with_gps(recording, full)
    slow.odometry.deviation[3, 2] = NOT_MEASURED
    assert np.count_nonzero(with_slow_state(slow, BEBOP).twist.deviation == NOT_MEASURED) == 1
    fast = with_gps(recording, full, 50.0)
    fast.odometry.deviation[3] = NOT_MEASURED
    assert with_slow_state(fast, BEBOP) is fast
    assert not with_slow_states(split_recording(fast), BEBOP)[1]


def test_blocks_are_corrected_as_the_whole(recording, full):
    slow = with_gps(recording, full)
    whole = with_slow_state(slow, BEBOP)
    blocks, corrects, since_ns = with_slow_states(split_recording(slow), BEBOP)
    assert corrects
    assert since_ns is not None
    joined = [block.pose.deviation for block in blocks]
    assert np.array_equal(np.concatenate(joined), whole.pose.deviation)
    fast = replace(recording, pose=None, odometry=with_gps(recording, full, 50.0).odometry, arrivals={})
    assert with_slow_state(fast, BEBOP) is fast
    assert not with_slow_states(split_recording(fast), BEBOP)[1]


@pytest.mark.parametrize(("poses", "is_slow"), [(190, True), (210, False)])
def test_velocities_that_begin_after_two_seconds_of_poses_count_for_nothing(recording, full, poses, is_slow):
    """Live, one by one, as in blocks of a recording."""
    slow = with_slow_state(with_gps(recording, full, 10.0), BEBOP)
    begin_ns = slow.pose.time_ns[100]
    before = begin_ns - 10_000_000 * np.arange(poses, 0, -1)
    pose = slow.pose.take(slow.pose.time_ns >= begin_ns)
    early = replace(pose.take(np.zeros(poses, dtype=int)), time_ns=before)
    joined = type(pose).join([early, pose])
    late = replace(slow, pose=joined, twist=slow.twist.take(slow.twist.time_ns >= begin_ns), arrivals={})
    # Live it is known when the fifth velocity has arrived.
    known_ns = int(late.twist.time_ns[4])
    for blocks in (iter([late]), split_recording(late)):
        since_ns = with_velocity_rate(blocks)[1]
        assert (since_ns is not None) == is_slow
        assert since_ns is None or 0 <= known_ns - since_ns < 5_000_000
    live = VelocityRate()
    for time_ns in joined.time_ns.tolist():
        before_ns = int(late.imu.time_ns[late.imu.time_ns <= time_ns][-1])
        live.take([time_ns] if time_ns >= begin_ns else [], [before_ns], poses=time_ns < begin_ns)
    assert live.slow_since_ns == since_ns


@pytest.mark.parametrize(("early_s", "late_s", "is_slow"), [(0.2, 0.01, True), (0.01, 0.2, False)])
def test_how_often_velocities_come_is_decided_once_by_the_first(recording, early_s, late_s, is_slow):
    """By five, whatever comes then, in blocks of any length; live, one by one, at the same sample."""
    imu_ns = recording.imu.time_ns
    steps = np.cumsum([early_s] * 5 + [late_s] * 20)
    stamps = imu_ns[100] + np.round(1e9 * steps).astype(np.int64)
    twist = TwistStream(stamps, np.zeros((25, 3)), np.zeros(25, dtype=bool))
    flown = replace(recording, twist=twist, arrivals={})
    before = imu_ns[np.searchsorted(imu_ns, stamps, side="right") - 1]
    expected = int(before[4]) if is_slow else None
    for blocks in (iter([flown]), split_recording(flown)):
        assert with_velocity_rate(blocks)[1] == expected
    live = VelocityRate()
    for stamp, imu in zip(stamps.tolist(), before.tolist(), strict=True):
        live.take([stamp], [imu])
    assert live.slow_since_ns == expected
