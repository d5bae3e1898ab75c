# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The NeuroBEM reader: physics of the real flights after conversion, and damaged files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from quadpi_core.errors import LogError
from quadpi_core.flight import Recording
from quadpi_core.frames import rotate_body_to_world, rotate_world_to_body
from quadpi_core.logs import read_recording
from quadpi_core.vehicle import Vehicle

SLOW = "bemnn20210223104803seg2.mat"
FAST = "bemnn20210218172600seg1.mat"


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("neurobem")


@pytest.fixture(scope="module", params=[SLOW, FAST])
def flight(request, shared_data: Path, vehicle: Vehicle) -> Recording:
    return read_recording(shared_data / "neurobem" / request.param, vehicle)


def test_streams_share_the_clock_of_the_file(flight: Recording):
    assert [stream.topic for stream in flight.streams()] == ["imu", "rotor_speeds", "mocap/pose", "odometry"]
    assert np.all(np.diff(flight.imu.time_ns) == 2_500_000)


def test_velocity_is_the_derivative_of_position(flight: Recording):
    odometry = flight.odometry
    time = odometry.time_ns * 1e-9
    velocity = rotate_body_to_world(odometry.attitude, odometry.velocity)
    derivative = np.gradient(odometry.position, time, axis=0)
    assert np.corrcoef(velocity.ravel(), derivative.ravel())[0, 1] > 0.999
    assert np.abs(velocity - derivative).mean() < 0.1


def test_specific_force_is_acceleration_without_gravity(flight: Recording, vehicle: Vehicle):
    odometry = flight.odometry
    time = odometry.time_ns * 1e-9
    velocity = rotate_body_to_world(odometry.attitude, odometry.velocity)
    acceleration = np.gradient(velocity, time, axis=0) - [0.0, 0.0, vehicle.gravity_m_s2]
    expected = rotate_world_to_body(odometry.attitude, acceleration)
    assert np.corrcoef(flight.imu.specific_force.ravel(), expected.ravel())[0, 1] > 0.98
    assert np.abs(np.mean(flight.imu.specific_force - expected, axis=0)).max() < 0.3


def test_thrust_points_up_and_carries_the_weight(shared_data: Path, vehicle: Vehicle):
    flight = read_recording(shared_data / "neurobem" / SLOW, vehicle)
    assert np.median(flight.imu.specific_force[:, 2]) == pytest.approx(-9.81, abs=0.15)
    assert np.median(flight.pose.position[:, 2]) < -2.0


def test_rotors_agree_with_the_moments(shared_data: Path, vehicle: Vehicle):
    """Thrust of each rotor at its place in the vehicle file must explain roll and pitch moments by sign."""
    flight = read_recording(shared_data / "neurobem" / FAST, vehicle)
    acceleration = np.gradient(flight.imu.angular_velocity, flight.imu.time_ns * 1e-9, axis=0)
    thrust = np.diff(flight.rotor_speeds.speeds**2, axis=0)
    roll = np.corrcoef(np.diff(acceleration[:, 0]), thrust @ -vehicle.rotor_positions[:, 1])[0, 1]
    pitch = np.corrcoef(np.diff(acceleration[:, 1]), thrust @ vehicle.rotor_positions[:, 0])[0, 1]
    assert min(roll, pitch) > 0.3


def write_matrix(path: Path, matrix: np.ndarray) -> Path:
    scipy.io.savemat(path, {"flight": matrix})
    return path


def synthetic_matrix(samples: int = 20) -> np.ndarray:
    matrix = np.zeros((samples, 41))
    matrix[:, 0] = np.arange(samples) / 400.0
    matrix[:, 10] = 1.0
    matrix[:, 13] = 9.8
    matrix[:, 17:20] = 1.0, 2.0, 3.0
    matrix[:, 28] = 160.0
    return matrix


def test_axes_convert_to_frd_and_ned(tmp_path: Path, vehicle: Vehicle):
    recording = read_recording(write_matrix(tmp_path / "flight.mat", synthetic_matrix()), vehicle)
    np.testing.assert_allclose(recording.imu.specific_force[0], [0.0, 0.0, -9.8])
    np.testing.assert_allclose(recording.pose.position[0], [2.0, 1.0, -3.0])
    np.testing.assert_allclose(recording.battery.voltage, 16.0)
    assert recording.name == "flight"


@pytest.mark.parametrize(
    ("cell", "value", "topic", "fault"),
    [
        ((4, 13), np.nan, "imu", "specific_force is not finite"),
        ((4, 0), 3 / 400.0, "imu", "stamp repeats"),
        ((4, 0), 0.0001, "imu", "stamp runs backward"),
        ((4, 0), np.nan, "imu", "stamp is no number from 1970 to 2038"),
        ((4, 10), 0.5, "mocap/pose", "attitude is no unit quaternion"),
    ],
)
def test_bad_samples_are_left_out(tmp_path: Path, vehicle: Vehicle, cell, value, topic, fault):
    matrix = synthetic_matrix()
    matrix[cell] = value
    recording = read_recording(write_matrix(tmp_path / "flight.mat", matrix), vehicle)
    assert (topic, f"whose {fault}", 4, 1) in [
        (said.topic, said.limit, said.first, said.samples) for said in recording.quality.left_out
    ]


def test_other_matrices_are_refused_with_a_mapping_to_start_from(tmp_path: Path, vehicle: Vehicle, caplog):
    with pytest.raises(LogError, match="expected one NeuroBEM matrix"):
        read_recording(write_matrix(tmp_path / "flight.mat", np.zeros((5, 7))), vehicle)
    assert "acceleration: {columns: ['?x', '?y', '?z'], unit: m/s2" in caplog.text


def test_damaged_files_are_refused(tmp_path: Path, vehicle: Vehicle):
    path = write_matrix(tmp_path / "flight.mat", synthetic_matrix())
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(LogError, match=r"flight\.mat"):
        read_recording(path, vehicle)
