# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink messages as samples: every unit, sign and frame against what the message's definition says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from quadpi_core.frames import rotate_body_to_world
from quadpi_core.logs.mavlink_samples import ARDUPILOT, PX4, MavlinkSamples, is_epoch, stream_of
from quadpi_core.rotor_order import RotorOrder
from quadpi_core.vehicle import Vehicle

RAD_S = 2 * np.pi / 60
INFINITE, NAN = float("inf"), float("nan")
IMU = (0.1, -0.2, -9.8, 0.5, -0.6, 0.7, *[0.0] * 7)
MILLI_IMU = (0, 100, -1000, 500, -250, 125, 0, 0, 0)
# Nose to the south-west, pitched and rolled.
TURN = Rotation.from_euler("ZYX", [-2.3, 0.3, 0.4])
WXYZ = TURN.as_quat(canonical=True, scalar_first=True)
Decode: TypeAlias = Callable[..., Any]


@pytest.fixture
def samples() -> MavlinkSamples:
    return MavlinkSamples(Vehicle.load("neurobem"), RotorOrder((3, 0, 1, 2), "rpm"))


@pytest.fixture
def decode(samples: MavlinkSamples, mavlink_message: Callable[..., Any]) -> Decode:
    """decode(name, *fields): the sample that a message completes, or None."""
    return lambda name, *values, at=0.0: samples.decode(mavlink_message(name, *values), at)


def test_a_companion_says_nothing_of_the_autopilot(samples: MavlinkSamples, decode: Decode) -> None:
    for kind, autopilot in ((2, ARDUPILOT), (18, 0), (6, 0), (26, 8)):
        decode("HEARTBEAT", kind, autopilot, 0, 0, 4, 3)
    assert samples.autopilot == ARDUPILOT


def test_highres_imu_is_in_si(samples: MavlinkSamples, decode: Decode) -> None:
    sample = decode("HIGHRES_IMU", 1234, *IMU, 0x3F, 0)
    assert (sample.topic, sample.source, sample.clock_us) == ("imu", "HIGHRES_IMU", 1234)
    assert sample.values == pytest.approx([0.5, -0.6, 0.7, 0.1, -0.2, -9.8])
    stream = stream_of("imu", np.array([1]), sample.values[np.newaxis])
    assert stream.specific_force[0, 2] == pytest.approx(-9.8)
    # Of another sensor, and without news.
    assert decode("HIGHRES_IMU", 1, *IMU, 0x3F, 1) is None
    assert decode("HIGHRES_IMU", 1, *IMU, 0x38, 0) is None
    assert samples.refused == {"HIGHRES_IMU: no new accelerometer and gyro values in it": 1}


@pytest.mark.parametrize("name", ["SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "RAW_IMU"])
def test_other_imus_are_in_thousandths(name: str, decode: Decode) -> None:
    """RAW_IMU only of ArduPilot."""
    decode("HEARTBEAT", 2, PX4, 0, 0, 4, 3)
    assert (decode(name, 77, *MILLI_IMU) is None) is (name == "RAW_IMU")
    decode("HEARTBEAT", 2, ARDUPILOT, 0, 0, 4, 3)
    sample = decode(name, 77, *MILLI_IMU)
    assert sample.clock_us == (77 if name == "RAW_IMU" else 77_000)
    assert sample.values == pytest.approx([0.5, -0.25, 0.125, 0.0, 0.980665, -9.80665])


def test_attitude_and_local_position_make_a_state(decode: Decode) -> None:
    local = ("LOCAL_POSITION_NED", 1000, 1.0, 2.0, -3.0, 4.0, 5.0, -6.0)
    assert decode(*local) is None
    decode("ATTITUDE_QUATERNION", 1000, *WXYZ, 0.1, 0.2, 0.3)
    state = stream_of("odometry", np.array([1]), decode(*local).values[np.newaxis])
    assert state.position[0] == pytest.approx([1, 2, -3])
    assert state.attitude[0] == pytest.approx(WXYZ)
    assert rotate_body_to_world(state.attitude, state.velocity)[0] == pytest.approx([4, 5, -6])
    assert state.velocity[0] == pytest.approx(TURN.inv().apply([4, 5, -6]))
    assert state.rates[0] == pytest.approx([0.1, 0.2, 0.3])


def test_an_older_attitude_is_carried_on_by_its_rates(decode: Decode) -> None:
    rates = np.array([0.5, -1.0, 2.0])
    decode("ATTITUDE_QUATERNION", 1000, *WXYZ, *rates)
    sample = decode("LOCAL_POSITION_NED", 1150, *[0.0] * 6)
    expected = (TURN * Rotation.from_rotvec(0.15 * rates)).as_quat(scalar_first=True)
    assert abs(sample.values[3:7] @ expected) == pytest.approx(1.0, abs=1e-6)
    assert decode("LOCAL_POSITION_NED", 1300, *[0.0] * 6) is None


def test_euler_angles_are_yaw_pitch_roll(decode: Decode) -> None:
    decode("ATTITUDE", 1000, 0.4, 0.3, -2.3, 0.0, 0.0, 0.0)
    sample = decode("LOCAL_POSITION_NED", 1000, *[0.0] * 6)
    assert abs(sample.values[3:7] @ WXYZ) == pytest.approx(1.0)


SAME = Rotation.identity()
FRD_TO_FLU = Rotation.from_quat([1, 0, 0, 0])
NED_TO_ENU = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])


@pytest.mark.parametrize(("frame", "world"), [(1, SAME), (4, NED_TO_ENU), (20, SAME), (21, FRD_TO_FLU)])
@pytest.mark.parametrize(("child", "body"), [(12, SAME), (8, SAME), (13, FRD_TO_FLU)])
def test_odometry_in_every_frame_is_the_same_state(
    frame: int, world: Rotation, child: int, body: Rotation, decode: Decode
) -> None:
    position, velocity, rates = [1.0, 2.0, -3.0], [4.0, 5.0, 6.0], [0.1, 0.2, 0.3]
    turned = (world * TURN * body.inv()).as_quat(scalar_first=True).tolist()
    sent = (*world.apply(position), turned, *body.apply(velocity), *body.apply(rates))
    values = decode("ODOMETRY", 5, frame, child, *sent, [0.0] * 21, [0.0] * 21, 0, 1, 0).values
    assert values[:3] == pytest.approx(position, abs=1e-5)
    assert abs(values[3:7] @ WXYZ) == pytest.approx(1.0, abs=1e-6)
    assert values[7:10] == pytest.approx(velocity, abs=1e-5)
    assert values[10:] == pytest.approx(rates, abs=1e-6)


def odometry(frame: int = 1, child: int = 12, vx: float = 0.0) -> tuple[Any, ...]:
    state = (1.0, 2.0, -3.0, WXYZ.tolist(), vx, 0.0, 0.0, 0.0, 0.0, 0.0)
    return "ODOMETRY", 5, frame, child, *state, [0.0] * 21, [0.0] * 21, 0, 1, 0


def test_odometry_without_velocity_is_a_pose(decode: Decode) -> None:
    """Motion capture sends NaN where it has none; an infinite one is not missing."""
    sample = decode(*odometry(vx=NAN))
    assert (sample.topic, sample.source) == ("mocap/pose", "ODOMETRY pose")
    assert sample.values == pytest.approx([1.0, 2.0, -3.0, *WXYZ])
    assert decode(*odometry(vx=INFINITE)) is None


@pytest.mark.parametrize(("frame", "child"), [(0, 12), (1, 1)])
def test_odometry_in_an_unknown_frame_is_refused(
    frame: int, child: int, samples: MavlinkSamples, decode: Decode
) -> None:
    assert decode(*odometry(frame, child)) is None
    assert "is not known" in next(iter(samples.refused))


def test_motion_capture_is_a_pose(decode: Decode) -> None:
    mocap = decode("ATT_POS_MOCAP", 5, WXYZ.tolist(), 1.0, 2.0, -3.0)
    vision = decode("VISION_POSITION_ESTIMATE", 5, 1.0, 2.0, -3.0, 0.4, 0.3, -2.3)
    assert mocap.topic == vision.topic == "mocap/pose"
    assert mocap.values == pytest.approx([1.0, 2.0, -3.0, *WXYZ])
    assert vision.values[:3] == pytest.approx([1.0, 2.0, -3.0])
    assert abs(vision.values[3:] @ WXYZ) == pytest.approx(1.0)
    assert decode("ATT_POS_MOCAP", 5, [0.0] * 4, 1.0, 2.0, -3.0) is None


def status(first: int, time_us: int, rpm: list[int]) -> tuple[Any, ...]:
    return "ESC_STATUS", first, time_us, rpm, [0.0] * 4, [0.0] * 4


def speeds(sample: Any) -> list[float]:
    assert sample.topic == "rotor_speeds"
    return (sample.values / RAD_S).tolist()


def test_esc_status_goes_to_the_rotors_of_the_vehicle(samples: MavlinkSamples, decode: Decode) -> None:
    sample = decode(*status(0, 777, [1000, -2000, 3000, 4000]))
    assert sample.clock_us == 777
    assert speeds(sample) == pytest.approx([4000, 1000, 2000, 3000])
    decode("ESC_INFO", 0, 1, 1, 4, 0, 0b0111, [0] * 4, [0] * 4, [0] * 4)
    assert decode(*status(0, 778, [1000, 2000, 3000, 0])) is None
    assert samples.refused == {"ESC_STATUS: an ESC is offline: controller 4": 1}


def test_esc_telemetry_has_no_stamp_and_counts_what_is_new(decode: Decode) -> None:
    def telemetry(count: int, at: float) -> Any:
        fields = (b"\x19" * 4, [0] * 4, [0] * 4, [0] * 4, [1000, 2000, 3000, 4000], [count] * 4)
        return decode("ESC_TELEMETRY_1_TO_4", *fields, at=at)

    sample = telemetry(1, 5.0)
    assert sample.clock_us is None
    assert speeds(sample) == pytest.approx([4000, 1000, 2000, 3000])
    assert telemetry(1, 5.1) is None
    assert telemetry(2, 5.2) is not None


def test_speeds_of_several_messages_are_put_together(mavlink_message: Callable[..., Any]) -> None:
    """Those of a message with an impossible stamp are not."""
    samples = MavlinkSamples(None, RotorOrder((0, 1, 4, 5), "rpm"))
    first, second = status(0, 1000, [1, 2, 3, 4]), [5, 6, 7, 8]
    for message, expected in (
        (first, None),
        (status(4, 1000, second), [1, 2, 5, 6]),
        (first, None),
        (status(4, 90_000, second), None),
        (first, None),
        (status(4, 2**63, [9] * 4), None),
        (status(4, 2000, second), [1, 2, 5, 6]),
    ):
        found = samples.decode(mavlink_message(*message), 0.0)
        assert found is None if expected is None else speeds(found) == pytest.approx(expected)


def test_raw_rpm_comes_one_rotor_at_a_time(decode: Decode) -> None:
    decoded = [decode("RAW_RPM", index, 1000.0 * (index + 1)) for index in range(4)]
    assert decoded[:3] == [None] * 3
    assert speeds(decoded[3]) == pytest.approx([4000, 1000, 2000, 3000])


@pytest.mark.parametrize(("clock_us", "since_1970"), [(10**15, False), (10**15 + 1, True)])
def test_stamps_after_2001_count_from_1970(clock_us: int, since_1970: bool) -> None:
    """No autopilot has run for the 31 years that they would be since its boot."""
    assert is_epoch(clock_us) is since_1970


def test_values_that_are_not_finite_and_stamps_after_2096_are_refused(
    samples: MavlinkSamples, decode: Decode
) -> None:
    assert decode("HIGHRES_IMU", 4 * 10**15, *IMU, 0x3F, 0)
    assert decode("HIGHRES_IMU", 4 * 10**15 + 1, *IMU, 0x3F, 0) is None
    assert decode("HIGHRES_IMU", 1, NAN, *IMU[1:], 0x3F, 0) is None
    assert sorted(samples.refused) == [
        "HIGHRES_IMU: an impossible stamp",
        "HIGHRES_IMU: values that are not finite",
    ]


@pytest.mark.parametrize("value", [INFINITE, -INFINITE, NAN])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_an_attitude_that_is_not_finite_is_not_kept(
    value: float, samples: MavlinkSamples, decode: Decode
) -> None:
    """A position after it would be turned and carried on by it."""

    def spoiled(fields: list[float], places: range) -> list[list[float]]:
        return [[value if place == k else field for k, field in enumerate(fields)] for place in places]

    local = ("LOCAL_POSITION_NED", 1000)
    for fields in spoiled([0.1] * 6, range(6)):
        assert decode("ATTITUDE", 1000, *fields) is None
        assert decode(*local, *[1.0] * 6) is None
    for fields in spoiled([1.0, *[0.0] * 6], range(4, 7)):
        assert decode("ATTITUDE_QUATERNION", 1000, *fields) is None
        assert decode(*local, *[1.0] * 6) is None
    assert samples.refused["ATTITUDE: values that are not finite"] == 6
    assert samples.refused["ATTITUDE_QUATERNION: values that are not finite"] == 3
    decode("ATTITUDE", 1000, *[0.1] * 6)
    for fields in spoiled([1.0] * 6, range(3, 6)):
        assert decode(*local, *fields) is None
    assert decode(*local, *[1.0] * 6)


def test_outputs_battery_and_air_of_a_log(mavlink_message: Callable[..., Any]) -> None:
    order = RotorOrder((3, 0, 1, 2), "rpm")
    samples = MavlinkSamples(None, order)

    def decode(name: str, *values: Any) -> Any:
        return samples.decode(mavlink_message(name, *values), 0.0)

    dshot = decode("ACTUATOR_OUTPUT_STATUS", 1234, 4, [400.0, 800.0, 1200.0, 1600.0, *[NAN] * 28])
    assert (dshot.topic, dshot.clock_us) == ("motor_commands", 1234)
    assert dshot.values == pytest.approx([0.8, 0.2, 0.4, 0.6])
    disarmed = decode("ACTUATOR_OUTPUT_STATUS", 1234, 4, [900.0] * 4 + [0.0] * 28)
    assert disarmed.values.tolist() == [0.0] * 4
    heartbeat = mavlink_message("HEARTBEAT", 2, ARDUPILOT, 0, 0, 4, 3)
    samples.decode(heartbeat, 0.0)
    pulses = decode("SERVO_OUTPUT_RAW", 99, 0, 1100, 1200, 1300, 1400, *[0] * 12)
    assert (pulses.source, pulses.clock_us) == ("SERVO_OUTPUT_RAW", None)
    assert pulses.values == pytest.approx([0.4, 0.1, 0.2, 0.3])
    assert decode("SERVO_OUTPUT_RAW", 99, 1, *[1500] * 16) is None
    cells = [4100, 4000, 3900, *[0xFFFF] * 7]
    battery = decode("BATTERY_STATUS", 0, 0, 1, 2500, cells, 100, 0, 0, 50)
    assert (battery.topic, battery.values.tolist()) == ("battery", [pytest.approx(12.0)])
    air = decode("SCALED_PRESSURE", 1000, 950.25, 0.0, 2310)
    assert (air.topic, air.clock_us) == ("pressure", 1_000_000)
    stream = stream_of("pressure", np.array([1]), air.values[np.newaxis])
    assert (stream.pressure[0], stream.celsius[0]) == (pytest.approx(95025.0), pytest.approx(23.1))
