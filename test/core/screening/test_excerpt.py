# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Windows of a recording on one grid, of signals that are linear in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.screening.excerpt import STEP_S, WINDOW_S, Excerpt, excerpt, rotor_excerpt

SLOPE = np.array([0.3, -0.2, 0.1])
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def stamps(seconds: float, rate_hz: float, seed: int) -> np.ndarray:
    """Increasing stamps of a sensor whose clock jitters; the ends are exact."""
    even = np.arange(0.0, seconds + 1e-9, 1.0 / rate_hz)
    even[1:-1] += np.random.default_rng(seed).uniform(-0.3, 0.3, len(even) - 2) / rate_hz
    return np.round(1e9 * even).astype(np.int64)


def rounding(time_ns: np.ndarray, slope: float) -> float:
    """Largest error of a mean: its integral is taken at samples, and as linear between them."""
    return slope * np.diff(1e-9 * time_ns).max() ** 2 / (4.0 * STEP_S)


def linear(time_ns: np.ndarray) -> np.ndarray:
    """(N, 3)"""
    return np.outer(1e-9 * time_ns, SLOPE) + 1.0


def swinging(seconds: float) -> Recording:
    """Rates, positions and squared rotor speeds linear in time, attitudes of random signs."""
    imu_ns, rotor_ns, pose_ns = (stamps(seconds, hz, int(hz)) for hz in (500.0, 300.0, 100.0))
    sign = np.random.default_rng(1).choice([-1.0, 1.0], (len(pose_ns), 1))
    squares = 1e5 * (1.0 + np.outer(1e-9 * rotor_ns, [1.0, 2.0, 3.0, 4.0]))
    return Recording(
        name="swinging",
        vehicle="bebop2",
        source="swinging",
        imu=ImuStream(imu_ns, linear(imu_ns), -linear(imu_ns)),
        rotor_speeds=RotorSpeedStream(rotor_ns, np.sqrt(squares)),
        pose=PoseStream(pose_ns, linear(pose_ns), sign * LEVEL),
    )


def without(recording: Recording, name: str, begin_s: float, end_s: float) -> Recording:
    """The recording with a pause of one topic between two of its samples."""
    stream = getattr(recording, name)
    seconds = 1e-9 * stream.time_ns
    return replace(recording, **{name: stream.take((seconds <= begin_s) | (seconds >= end_s))})


def windows(sample: Excerpt | None) -> int:
    return 0 if sample is None else len(sample.rates)


def test_a_mean_of_what_is_linear_is_its_value_in_the_middle_of_the_cell():
    recording = swinging(5.0)
    sample = excerpt(recording, recording.pose)
    assert (sample.topic, sample.step_s) == ("mocap/pose", STEP_S)
    assert sample.rates.shape == (2, round(WINDOW_S / STEP_S), 3)
    for k, begin_s in enumerate((0.0, 2.5)):
        borders = np.round(1e9 * (begin_s + STEP_S * np.arange(251))).astype(np.int64)
        np.testing.assert_allclose(sample.position[k], linear(borders), rtol=1e-9)
        middle = linear(borders[:-1] + round(0.5e9 * STEP_S))
        close = {"rtol": 0.0, "atol": rounding(recording.imu.time_ns, SLOPE.max())}
        np.testing.assert_allclose(sample.rates[k], middle, **close)
        np.testing.assert_allclose(sample.force[k], -middle, **close)
    np.testing.assert_allclose(np.abs(sample.attitude[..., 0]), 1.0, rtol=1e-12)
    assert (np.ptp(sample.attitude[..., 0], axis=1) == 0.0).all()


def test_rotor_speeds_are_squared_and_reach_beyond_the_windows_by_their_largest_lag():
    recording = swinging(6.0)
    sample = rotor_excerpt(recording)
    assert sample.margin == 40
    assert sample.squares.shape == (2, 250 + 2 * 40, 4)
    assert sample.rates.shape == (2, 250, 3)
    for k, begin_s in enumerate((0.4, 3.1)):
        middle_s = begin_s + STEP_S * (np.arange(-40, 290) + 0.5)
        expected = 1e5 * (1.0 + np.outer(middle_s, [1.0, 2.0, 3.0, 4.0]))
        close = rounding(recording.rotor_speeds.time_ns, 4e5)
        np.testing.assert_allclose(sample.squares[k], expected, rtol=0.0, atol=close)
    assert rotor_excerpt(replace(recording, rotor_speeds=None)) is None


@pytest.mark.parametrize(("name", "bridged_s"), [("imu", 0.1), ("pose", 0.3)])
def test_a_window_in_which_a_topic_pauses_is_left_out(name, bridged_s):
    """Poses may be slow: the IMU shows the motion between them."""
    recording = swinging(10.0)
    for pause_s, left in ((0.8 * bridged_s, 4), (1.2 * bridged_s, 3)):
        paused = without(recording, name, 4.0, 4.0 + pause_s)
        assert windows(excerpt(paused, paused.pose)) == left


@pytest.mark.parametrize(("begin_s", "count"), [(0.05, 1), (0.15, 0)])
def test_samples_at_an_end_that_a_pause_parts_from_the_others_cost_no_window(begin_s, count):
    assert windows(rotor_excerpt(without(swinging(2.5), "rotor_speeds", begin_s, 0.4))) == count
    assert windows(rotor_excerpt(without(swinging(2.5), "rotor_speeds", 2.1, 2.5 - begin_s))) == count


def test_a_window_with_stamps_that_do_not_increase_is_left_out():
    recording = swinging(10.0)
    time_ns = recording.imu.time_ns.copy()
    time_ns[2000] = time_ns[1999]
    repeated = replace(recording, imu=replace(recording.imu, time_ns=time_ns))
    assert windows(excerpt(repeated, repeated.pose)) == 3


@pytest.mark.parametrize(("seconds", "count"), [(0.98, 0), (1.02, 1), (2.0, 1), (5.1, 2), (120.0, 24)])
def test_a_second_is_enough_and_windows_are_few(seconds, count):
    recording = swinging(seconds)
    assert windows(excerpt(recording, recording.pose)) == count
