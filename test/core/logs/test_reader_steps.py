# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that readers share: dropped samples, states of separate messages, vehicles of another kind."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from quadpi_core.errors import LogError
from quadpi_core.flight import NO_STAMP, ImuStream
from quadpi_core.logs.reader_steps import (
    Airframe,
    has_rotors,
    normalised_attitude,
    odometry_of,
    require_imu,
    rotors_together,
    stamps_ns,
)
from quadpi_core.rotor_order import RPM, RotorOrder
from quadpi_core.vehicle import Vehicle

SECOND = 10**9


def imu(*time_ns, force=0.0):
    count = len(time_ns)
    return ImuStream(np.array(time_ns), np.zeros((count, 3)), np.full((count, 3), force))


def test_a_log_without_an_imu_names_the_messages_that_would_hold_it():
    assert require_imu("a.ulg", imu(1), "sensor_combined").time_ns.tolist() == [1]
    with pytest.raises(
        LogError, match=r"^a\.ulg: topic imu: the log holds no samples of .* \(sensor_combined\)$"
    ):
        require_imu("a.ulg", None, "sensor_combined")


def state(gap_s):
    """Odometry at 0.1 s to 0.9 s of the way between two attitudes that are `gap_s` apart."""
    times = np.array([0, round(gap_s * SECOND)])
    turns = Rotation.from_euler("ZYX", [[0.3, 0.1, -0.2], [1.2, -0.3, 0.1]])
    at = np.round(np.linspace(0.1, 0.9, 9) * gap_s * SECOND).astype(np.int64)
    position, velocity = np.random.default_rng(0).normal(size=(2, 9, 3))
    attitude = (times, turns.as_quat(scalar_first=True))
    gyro = ImuStream(
        np.arange(0, times[1] + 1, SECOND // 100), *np.zeros((2, times[1] // (SECOND // 100) + 1, 3))
    )
    between = Slerp(times, turns)(at)
    return odometry_of(at, position, velocity, attitude, gyro), position, velocity, between


def test_an_attitude_of_another_message_is_interpolated_along_the_rotation():
    found, position, velocity, between = state(0.99)
    np.testing.assert_array_equal(found.position, position)
    turned = np.abs(np.sum(found.attitude * between.as_quat(scalar_first=True), axis=1))
    # The chord for the arc: a turn of 0.9 rad makes less than a thousandth.
    np.testing.assert_allclose(turned, 1.0, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(found.attitude, axis=1), 1.0)
    attitude = Rotation.from_quat(found.attitude, scalar_first=True)
    np.testing.assert_allclose(found.velocity, attitude.inv().apply(velocity), atol=1e-12)


def test_attitudes_more_than_a_second_apart_are_not_interpolated():
    assert len(state(0.999)[0]) == 9
    assert state(1.001)[0] is None
    nothing = np.empty(0, np.int64), np.empty((0, 4))
    assert odometry_of(np.array([1]), np.zeros((1, 3)), np.zeros((1, 3)), nothing, imu(1)) is None


def controllers(*periods_ns):
    """Speed controllers that report at different rates; each says its number, growing by 1 in a second."""
    found = []
    for number, period in enumerate(periods_ns):
        time_ns = np.arange(0, 3 * SECOND, period)
        found.append((time_ns, (100.0 * (number + 1) + time_ns / SECOND)[:, np.newaxis]))
    return found


def test_rotors_that_are_logged_apart_are_taken_at_the_stamps_of_the_most_frequent():
    stream = rotors_together(
        controllers(*(SECOND // hz for hz in (10, 50, 20, 5))), RotorOrder((0, 1, 2, 3), RPM), None
    )
    rpm = stream.speeds * 60.0 / (2.0 * np.pi)
    seconds = stream.time_ns / SECOND
    np.testing.assert_allclose(np.diff(seconds), 0.02)
    np.testing.assert_allclose(rpm, np.arange(1, 5) * 100.0 + seconds[:, np.newaxis])
    assert seconds[-1] == pytest.approx(2.8)
    assert (
        rotors_together(
            [*controllers(*[SECOND] * 3), (np.empty(0, np.int64), np.empty((0, 1)))],
            RotorOrder((0, 1, 2, 3), RPM),
            None,
        )
        is None
    )


def test_clocks_in_any_unit_become_nanoseconds():
    assert stamps_ns(np.array([0.0, 1.5, 2.0**33])).tolist() == [0, 1_500_000_000, 2**33 * SECOND]
    assert stamps_ns(np.array([12.3456]), 1e-3).tolist() == [12_345_600]
    # 64 bits of nanoseconds end after 292 years.
    assert stamps_ns(np.array([1.0, np.nan, 9.3e9])).tolist() == [SECOND, NO_STAMP, NO_STAMP]


def test_a_rounded_attitude_is_scaled_and_one_that_is_none_stays():
    level = np.array([[1.0, 0.0, 0.0, 0.0]])
    for norm in (0.951, 1.049):
        np.testing.assert_allclose(normalised_attitude(norm * level), level)
    for norm in (0.0, 0.949, 1.051, np.nan):
        np.testing.assert_array_equal(normalised_attitude(norm * level), norm * level)


def test_between_a_speed_and_none_a_controller_that_is_logged_apart_reads_none():
    fast, slow = controllers(SECOND // 100, SECOND // 10)
    slow[1][10] = 0.0
    speeds = rotors_together([fast, slow, fast, fast], RotorOrder((0, 1, 2, 3), RPM), None).speeds
    assert np.flatnonzero(speeds[:, 1] == 0.0).tolist() == list(range(91, 110))


@pytest.mark.parametrize(
    ("rotors", "name"), [(3, "a tricopter"), (5, "a vehicle of 5 rotors"), (8, "an octocopter")]
)
def test_other_multicopters_are_refused_by_name(rotors: int, name: str) -> None:
    airframe = Airframe.of_rotors(f"N {rotors}", rotors)
    with pytest.raises(LogError, match=rf"^a\.log: N {rotors} is {name}; vehicle bebop2 has 4 rotors$"):
        has_rotors("a.log", airframe, Vehicle.load("bebop2"))
    assert has_rotors("a.log", airframe, None)


@pytest.mark.parametrize(("mav_type", "its_rotors"), [(0, True), (2, True), (1, False), (21, False)])
def test_what_is_no_multicopter_is_noted(mav_type: int, its_rotors: bool, caplog) -> None:
    assert has_rotors("a.log", Airframe.of_mav_type("MAV_TYPE", mav_type), None) is its_rotors
    assert ("rules out identification, prediction and replay" in caplog.text) is not its_rotors
