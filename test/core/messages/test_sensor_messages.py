# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import fields

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import (
    NOT_MEASURED,
    ImuStream,
    OdometryStream,
    PoseStream,
    RotorSpeedStream,
    TwistStream,
    WindStream,
)
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import codec, typestore
from quadpi_core.messages.payloads import Payloads
from quadpi_core.vehicle import SensorNoise, Vehicle

N = 7
TIME_NS = 1_700_000_000_999_999_990 + 7 * np.arange(N)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def attitudes(rng):
    quaternion = rng.normal(size=(N, 4))
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)


def reference(payloads, type_name):
    """Each message as rosbags reads it; rosbags must also write the same bytes."""
    decoded = [typestore().deserialize_cdr(message, type_name) for message in payloads]
    for one, message in zip(decoded, payloads, strict=True):
        assert bytes(typestore().serialize_cdr(one, type_name)) == message
    assert [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in decoded] == TIME_NS.tolist()
    return decoded


def vector(message):
    return [message.x, message.y, message.z]


def assert_same(actual, expected):
    for column in fields(expected):
        np.testing.assert_allclose(
            getattr(actual, column.name), getattr(expected, column.name), rtol=1e-15, atol=1e-15
        )


def test_imu_is_flu_and_marks_orientation_absent(rng):
    stream = ImuStream(TIME_NS, rng.normal(size=(N, 3)), rng.normal(size=(N, 3)))
    payloads = sensor_messages.pack_imu(stream, "drone/base")
    for one, rates, force in zip(
        reference(payloads, sensor_messages.IMU), stream.angular_velocity, stream.specific_force, strict=True
    ):
        assert vector(one.angular_velocity) == [rates[0], -rates[1], -rates[2]]
        assert vector(one.linear_acceleration) == [force[0], -force[1], -force[2]]
        assert one.orientation_covariance[0] == -1.0
        assert one.header.frame_id == "drone/base"
    assert_same(sensor_messages.unpack_imu(payloads), stream)
    assert sensor_messages.unpack_imu(payloads[3]).time_ns.tolist() == [TIME_NS[3]]


@pytest.mark.parametrize(("variance", "deviation"), [(0.04, 0.2), (0.81, 0.9), (1.0, 0.0), (np.nan, 0.0)])
def test_an_orientation_whose_covariance_is_filled_in_says_no_noise(variance, deviation):
    message = codec(sensor_messages.IMU).encode(
        1,
        {
            **sensor_messages.header_columns(TIME_NS[:1], "base_link"),
            "orientation": np.array([[0.0, 0.0, 0.0, 1.0]]),
            "orientation_covariance": np.diag([variance] * 3).reshape(1, 9),
            "angular_velocity": np.zeros((1, 3)),
            "linear_acceleration": np.zeros((1, 3)),
        },
    )
    assert sensor_messages.unpack_orientation(message)[2].tolist() == pytest.approx([deviation])


def test_pose_is_enu_with_x_first_quaternion(rng):
    stream = PoseStream(TIME_NS, rng.normal(size=(N, 3)), attitudes(rng))
    payloads = sensor_messages.pack_pose(stream)
    for one, (north, east, down) in zip(
        reference(payloads, sensor_messages.POSE), stream.position, strict=True
    ):
        assert vector(one.pose.position) == [east, north, -down]
    assert_same(sensor_messages.unpack_pose(payloads), stream)


def test_level_vehicle_that_faces_north_is_yawed_left_of_east():
    level = PoseStream(TIME_NS[:1], np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))
    orientation = (
        typestore()
        .deserialize_cdr(sensor_messages.pack_pose(level)[0], sensor_messages.POSE)
        .pose.orientation
    )
    half = np.sqrt(0.5)
    found = np.array([orientation.x, orientation.y, orientation.z, orientation.w])
    np.testing.assert_allclose(found, [0.0, 0.0, half, half], atol=1e-15)


@pytest.mark.parametrize(
    ("frame", "body_frame", "in_body"),
    [
        ("base_link", "base_link", True),
        ("base_link", "uav1/base_link", True),
        ("uav1/base_link", "base_link", True),
        ("map", "uav1/base_link", False),
        ("uav1", "uav1/base_link", False),
    ],
)
def test_a_velocity_is_in_body_axes_whatever_the_namespace(frame, body_frame, in_body):
    stream = TwistStream(np.array([1]), np.array([[1.0, 2.0, 3.0]]), np.array([True]))
    payloads = sensor_messages.pack_twist(stream, body_frame=frame)
    assert sensor_messages.unpack_twist(payloads, body_frame).in_body == [in_body]


def test_odometry_keeps_twist_in_the_body(rng):
    variances = rng.random(size=(N, 6))
    deviation = np.sqrt(
        np.stack([variances[:, own].mean(axis=1) for own in ([0, 1, 2], [3, 4, 5], [0, 1, 2])], 1)
    )
    stream = OdometryStream(
        TIME_NS,
        rng.normal(size=(N, 3)),
        attitudes(rng),
        rng.normal(size=(N, 3)),
        rng.normal(size=(N, 3)),
        deviation,
    )
    covariance = variances[:, np.newaxis] * np.eye(6)
    payloads = sensor_messages.pack_odometry(stream, covariance, covariance)
    for sample, one in enumerate(reference(payloads, sensor_messages.ODOMETRY)):
        assert vector(one.twist.twist.linear) == (stream.velocity[sample] * [1, -1, -1]).tolist()
        assert vector(one.twist.twist.angular) == (stream.rates[sample] * [1, -1, -1]).tolist()
        assert (one.header.frame_id, one.child_frame_id) == ("map", "base_link")
        assert one.pose.covariance[::7].tolist() == variances[sample, [1, 0, 2, 4, 3, 5]].tolist()
        assert one.twist.covariance[::7].tolist() == variances[sample].tolist()
        assert not np.signbit([*one.pose.covariance, *one.twist.covariance]).any()
    assert_same(sensor_messages.unpack_odometry(payloads), stream)


def test_variances_that_stand_for_nothing_are_none(rng):
    stream = OdometryStream(TIME_NS, np.ones((N, 3)), attitudes(rng), np.ones((N, 3)), np.ones((N, 3)))
    covariance = np.zeros((N, 6, 6))
    covariance[:, 0, 0], covariance[1:, 3:, 3:] = -1.0, 1e6 * np.eye(3)
    found = sensor_messages.unpack_odometry(sensor_messages.pack_odometry(stream, covariance, covariance))
    assert found.deviation[0].tolist() == [0.0, 0.0, 0.0]
    assert found.deviation[1].tolist() == [0.0, NOT_MEASURED, 0.0]


def test_odometry_of_motion_capture_is_no_surer_than_the_vehicle_file_says(rng):
    stream = OdometryStream(TIME_NS, np.ones((N, 3)), attitudes(rng), np.ones((N, 3)), np.ones((N, 3)))
    covariance = np.zeros((N, 6, 6))
    covariance[1], covariance[2], covariance[3] = 1e-9 * np.eye(6), 0.25 * np.eye(6), 1e6 * np.eye(6)
    payloads = sensor_messages.pack_odometry(stream, covariance, covariance)
    noise = SensorNoise(mocap_position_m=0.004, state_attitude_rad=0.1)
    pose, twist = sensor_messages.unpack_logged_mocap_odometry(payloads, noise)
    surest = noise.mocap_attitude_rad, noise.mocap_velocity_m_s
    assert pose.deviation[:4].tolist() == [[0.0, 0.1], [0.004, surest[0]], [0.5, 0.5], [-1.0, -1.0]]
    assert twist.deviation[:4].tolist() == [0.0, surest[1], 0.5, NOT_MEASURED]


@pytest.mark.parametrize(
    "orientation",
    [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.1), (np.inf, 0.0, 0.0, 1.0), (np.inf, -np.inf, 0.0, 0.0)],
)
def test_orientation_that_is_no_unit_quaternion_is_refused(rng, orientation):
    payloads = sensor_messages.pack_pose(PoseStream(TIME_NS, np.zeros((N, 3)), attitudes(rng)))
    broken = bytearray(payloads[4])
    broken[-32:] = np.array(orientation).tobytes()
    together = Payloads.join([*list(payloads)[:4], bytes(broken)])
    with pytest.raises(LogError, match="sample 4: the orientation is no unit quaternion"):
        sensor_messages.unpack_pose(together)


def test_wind_and_rotor_speeds(rng):
    wind = WindStream(TIME_NS, rng.normal(size=(N, 3)))
    payloads = sensor_messages.pack_wind(wind)
    for one, (north, east, down) in zip(
        reference(payloads, sensor_messages.WIND), wind.velocity, strict=True
    ):
        assert vector(one.vector) == [east, north, -down]
    assert_same(sensor_messages.unpack_wind(payloads), wind)
    rotors = RotorSpeedStream(TIME_NS, rng.uniform(0, 900, size=(N, 4)))
    payloads = sensor_messages.pack_rotor_speeds(rotors)
    for one, speeds in zip(reference(payloads, sensor_messages.ROTOR_SPEEDS), rotors.speeds, strict=True):
        np.testing.assert_array_equal(one.rotor_speeds, speeds)
    assert_same(sensor_messages.unpack_rotor_speeds(payloads), rotors)


def test_erpm_becomes_mechanical_by_the_pole_pairs(rng):
    vehicle = Vehicle(
        name="test",
        mass_kg=1.0,
        inertia=np.eye(3),
        rotor_radius_m=0.1,
        rotor_positions=np.zeros((4, 3)),
        rotor_spins=np.ones(4),
        pole_pairs=7,
        rotor_speed_max_rad_s=1000.0,
    )
    erpm = rng.uniform(1e4, 9e4, size=(N, 4))
    payloads = sensor_messages.pack_erpm(TIME_NS, erpm)
    np.testing.assert_array_equal(reference(payloads, sensor_messages.ERPM)[2].erpm, erpm[2])
    np.testing.assert_allclose(
        sensor_messages.unpack_erpm(payloads, vehicle).speeds, erpm * 2 * np.pi / 60 / 7
    )


@pytest.mark.parametrize(
    ("type_name", "field", "linear", "angular"),
    [
        (sensor_messages.WRENCH, "wrench", "force", "torque"),
        (sensor_messages.ACCELERATION, "accel", "linear", "angular"),
    ],
)
def test_pairs_of_body_vectors_are_flu(rng, type_name, field, linear, angular):
    vectors = rng.normal(size=(N, 6))
    payloads = sensor_messages.pack_body_vectors(TIME_NS, vectors, type_name)
    for one, sample in zip(reference(payloads, type_name), vectors, strict=True):
        pair = getattr(one, field)
        assert vector(getattr(pair, linear)) == [sample[0], -sample[1], -sample[2]]
        assert vector(getattr(pair, angular)) == [sample[3], -sample[4], -sample[5]]
        assert one.header.frame_id == "base_link"
    time_ns, found = sensor_messages.unpack_body_vectors(payloads, type_name)
    np.testing.assert_array_equal(time_ns, TIME_NS)
    np.testing.assert_array_equal(found, vectors)
