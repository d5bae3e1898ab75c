# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink messages as samples: every unit, sign and frame against what the message's definition says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from quadpi_core.logs.mavlink_frames import Framer, MessageDecoder
from quadpi_core.logs.mavlink_samples import ARDUPILOT, PX4, MavlinkSamples, Sample, is_epoch, stream_of
from quadpi_core.rotations import rotate_body_to_world
from quadpi_core.rotor_order import RotorOrder
from quadpi_core.vehicle import Vehicle

RAD_S = 2 * np.pi / 60
IMU = (0.1, -0.2, -9.8, 0.5, -0.6, 0.7, *[0.0] * 7)
# Nose to the south-west, pitched and rolled.
TURN = Rotation.from_euler("ZYX", [-2.3, 0.3, 0.4])
WXYZ = TURN.as_quat(canonical=True, scalar_first=True)


@pytest.fixture
def samples() -> MavlinkSamples:
    return MavlinkSamples(Vehicle.load("neurobem"), RotorOrder((3, 0, 1, 2), "rpm"))


def heartbeat(mavlink_message: Callable[..., Any], autopilot: int) -> Any:
    return mavlink_message("HEARTBEAT", 2, autopilot, 0, 0, 4, 3)


def test_a_companion_says_nothing_of_the_autopilot(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    samples.decode(heartbeat(mavlink_message, ARDUPILOT), 0.0)
    for kind, autopilot in ((18, 0), (6, 0), (26, 8)):
        samples.decode(mavlink_message("HEARTBEAT", kind, autopilot, 0, 0, 4, 3), 0.0)
    assert samples.autopilot == ARDUPILOT


def test_highres_imu_is_in_si(samples: MavlinkSamples, mavlink_message: Callable[..., Any]) -> None:
    sample = samples.decode(mavlink_message("HIGHRES_IMU", 1234, *IMU, 0x3F, 0), 0.0)
    assert (sample.topic, sample.source, sample.clock_us) == ("imu", "HIGHRES_IMU", 1234)
    assert sample.values == pytest.approx([0.5, -0.6, 0.7, 0.1, -0.2, -9.8])
    stream = stream_of("imu", np.array([1]), sample.values[np.newaxis])
    assert stream.specific_force[0, 2] == pytest.approx(-9.8)


def test_highres_imu_without_news_or_of_another_sensor_is_passed_over(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    assert samples.decode(mavlink_message("HIGHRES_IMU", 1, *IMU, 0x38, 0), 0.0) is None
    assert samples.refused == {"HIGHRES_IMU: no new accelerometer and gyro values in it": 1}
    assert samples.decode(mavlink_message("HIGHRES_IMU", 1, *IMU, 0x3F, 1), 0.0) is None


@pytest.mark.parametrize("name", ["SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"])
def test_scaled_imu_is_in_thousandths(
    name: str, samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    sample = samples.decode(mavlink_message(name, 77, 0, 100, -1000, 500, -250, 125, 0, 0, 0), 0.0)
    assert sample.clock_us == 77_000
    assert sample.values == pytest.approx([0.5, -0.25, 0.125, 0.0, 0.980665, -9.80665])


def test_raw_imu_is_scaled_only_by_ardupilot(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    raw = mavlink_message("RAW_IMU", 99, 0, 100, -1000, 500, -250, 125, 0, 0, 0)
    samples.decode(heartbeat(mavlink_message, PX4), 0.0)
    assert samples.decode(raw, 0.0) is None
    samples.decode(heartbeat(mavlink_message, ARDUPILOT), 0.0)
    sample = samples.decode(raw, 0.0)
    assert sample.clock_us == 99
    assert sample.values == pytest.approx([0.5, -0.25, 0.125, 0.0, 0.980665, -9.80665])


def test_attitude_and_local_position_make_a_state(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    local = mavlink_message("LOCAL_POSITION_NED", 1000, 1.0, 2.0, -3.0, 4.0, 5.0, -6.0)
    assert samples.decode(local, 0.0) is None
    samples.decode(mavlink_message("ATTITUDE_QUATERNION", 1000, *WXYZ, 0.1, 0.2, 0.3), 0.0)
    sample = samples.decode(local, 0.0)
    state = stream_of("odometry", np.array([1]), sample.values[np.newaxis])
    assert state.position[0] == pytest.approx([1, 2, -3])
    assert state.attitude[0] == pytest.approx(WXYZ)
    assert rotate_body_to_world(state.attitude, state.velocity)[0] == pytest.approx([4, 5, -6])
    assert state.velocity[0] == pytest.approx(TURN.inv().apply([4, 5, -6]))
    assert state.rates[0] == pytest.approx([0.1, 0.2, 0.3])


def test_an_older_attitude_is_carried_on_by_its_rates(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    rates = np.array([0.5, -1.0, 2.0])
    samples.decode(mavlink_message("ATTITUDE_QUATERNION", 1000, *WXYZ, *rates), 0.0)
    sample = samples.decode(mavlink_message("LOCAL_POSITION_NED", 1150, *[0.0] * 6), 0.0)
    turned = TURN * Rotation.from_rotvec(0.15 * rates)
    expected = turned.as_quat(scalar_first=True)
    assert abs(sample.values[3:7] @ expected) == pytest.approx(1.0, abs=1e-6)
    assert samples.decode(mavlink_message("LOCAL_POSITION_NED", 1300, *[0.0] * 6), 0.0) is None


def test_euler_angles_are_yaw_pitch_roll(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    samples.decode(mavlink_message("ATTITUDE", 1000, 0.4, 0.3, -2.3, 0.0, 0.0, 0.0), 0.0)
    sample = samples.decode(mavlink_message("LOCAL_POSITION_NED", 1000, *[0.0] * 6), 0.0)
    assert abs(sample.values[3:7] @ WXYZ) == pytest.approx(1.0)


FRD_TO_FLU = Rotation.from_quat([1, 0, 0, 0])
NED_TO_ENU = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])


@pytest.mark.parametrize(
    ("frame", "world"), [(1, Rotation.identity()), (4, NED_TO_ENU), (20, None), (21, FRD_TO_FLU)]
)
@pytest.mark.parametrize(("child", "body"), [(12, Rotation.identity()), (8, None), (13, FRD_TO_FLU)])
def test_odometry_in_every_frame_is_the_same_state(
    frame: int,
    world: Rotation | None,
    child: int,
    body: Rotation | None,
    samples: MavlinkSamples,
    mavlink_message: Callable[..., Any],
) -> None:
    world, body = world or Rotation.identity(), body or Rotation.identity()
    position, velocity, rates = [1.0, 2.0, -3.0], [4.0, 5.0, 6.0], [0.1, 0.2, 0.3]
    turned = (world * TURN * body.inv()).as_quat(scalar_first=True).tolist()
    sent = (*world.apply(position), turned, *body.apply(velocity), *body.apply(rates))
    message = mavlink_message("ODOMETRY", 5, frame, child, *sent, [0.0] * 21, [0.0] * 21, 0, 1, 0)
    values = samples.decode(message, 0.0).values
    assert values[:3] == pytest.approx(position, abs=1e-5)
    assert abs(values[3:7] @ WXYZ) == pytest.approx(1.0, abs=1e-6)
    assert values[7:10] == pytest.approx(velocity, abs=1e-5)
    assert values[10:] == pytest.approx(rates, abs=1e-6)


def odometry(mavlink_message: Callable[..., Any], frame: int = 1, child: int = 12, vx: float = 0.0) -> Any:
    covariance = [0.0] * 21
    state = (1.0, 2.0, -3.0, WXYZ.tolist(), vx, 0.0, 0.0, 0.0, 0.0, 0.0)
    return mavlink_message("ODOMETRY", 5, frame, child, *state, covariance, covariance, 0, 1, 0)


def test_odometry_without_velocity_is_a_pose(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    sample = samples.decode(odometry(mavlink_message, vx=np.nan), 0.0)
    assert (sample.topic, sample.source) == ("mocap/pose", "ODOMETRY pose")
    assert sample.values == pytest.approx([1.0, 2.0, -3.0, *WXYZ])


@pytest.mark.parametrize(("frame", "child"), [(0, 12), (1, 1)])
def test_odometry_in_an_unknown_frame_is_refused(
    frame: int, child: int, samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    assert samples.decode(odometry(mavlink_message, frame, child), 0.0) is None
    assert "is not known" in next(iter(samples.refused))


def test_motion_capture_is_a_pose(samples: MavlinkSamples, mavlink_message: Callable[..., Any]) -> None:
    mocap = samples.decode(mavlink_message("ATT_POS_MOCAP", 5, WXYZ.tolist(), 1.0, 2.0, -3.0), 0.0)
    vision = samples.decode(
        mavlink_message("VISION_POSITION_ESTIMATE", 5, 1.0, 2.0, -3.0, 0.4, 0.3, -2.3), 0.0
    )
    assert mocap.topic == vision.topic == "mocap/pose"
    assert mocap.values == pytest.approx([1.0, 2.0, -3.0, *WXYZ])
    assert vision.values[:3] == pytest.approx([1.0, 2.0, -3.0])
    assert abs(vision.values[3:] @ WXYZ) == pytest.approx(1.0)
    zero = mavlink_message("ATT_POS_MOCAP", 5, [0.0] * 4, 1.0, 2.0, -3.0)
    assert samples.decode(zero, 0.0) is None


def speeds(sample: Sample | None) -> list[float]:
    assert sample
    assert sample.topic == "rotor_speeds"
    return (sample.values / RAD_S).tolist()


def test_esc_status_goes_to_the_rotors_of_the_vehicle(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    status = mavlink_message("ESC_STATUS", 0, 777, [1000, -2000, 3000, 4000], [0.0] * 4, [0.0] * 4)
    sample = samples.decode(status, 0.0)
    assert sample.clock_us == 777
    assert speeds(sample) == pytest.approx([4000, 1000, 2000, 3000])


def test_an_esc_that_is_offline_gives_no_speed(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    info = (0, 1, 1, 4, 0, 0b0111, [0] * 4, [0] * 4, [0] * 4)
    samples.decode(mavlink_message("ESC_INFO", *info), 0.0)
    status = mavlink_message("ESC_STATUS", 0, 777, [1000, 2000, 3000, 0], [0.0] * 4, [0.0] * 4)
    assert samples.decode(status, 0.0) is None
    assert samples.refused == {"ESC_STATUS: an ESC is offline: controller 4": 1}


def test_esc_telemetry_has_no_stamp_and_counts_what_is_new(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    def telemetry(count: int) -> Any:
        rpm = [1000, 2000, 3000, 4000]
        return mavlink_message(
            "ESC_TELEMETRY_1_TO_4", b"\x19" * 4, [0] * 4, [0] * 4, [0] * 4, rpm, [count] * 4
        )

    sample = samples.decode(telemetry(1), 5.0)
    assert sample.clock_us is None
    assert speeds(sample) == pytest.approx([4000, 1000, 2000, 3000])
    assert samples.decode(telemetry(1), 5.1) is None
    assert samples.decode(telemetry(2), 5.2) is not None


def test_speeds_of_several_messages_are_put_together(mavlink_message: Callable[..., Any]) -> None:
    samples = MavlinkSamples(None, RotorOrder((0, 1, 4, 5), "rpm"))
    first = mavlink_message("ESC_STATUS", 0, 1000, [1, 2, 3, 4], [0.0] * 4, [0.0] * 4)
    second = mavlink_message("ESC_STATUS", 4, 1000, [5, 6, 7, 8], [0.0] * 4, [0.0] * 4)
    late = mavlink_message("ESC_STATUS", 4, 90_000, [5, 6, 7, 8], [0.0] * 4, [0.0] * 4)
    assert samples.decode(first, 0.0) is None
    assert speeds(samples.decode(second, 0.0)) == pytest.approx([1, 2, 5, 6])
    assert samples.decode(first, 0.0) is None
    assert samples.decode(late, 0.0) is None


def test_raw_rpm_comes_one_rotor_at_a_time(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    decoded = [
        samples.decode(mavlink_message("RAW_RPM", index, 1000.0 * (index + 1)), 0.0) for index in range(4)
    ]
    assert decoded[:3] == [None] * 3
    assert speeds(decoded[3]) == pytest.approx([4000, 1000, 2000, 3000])


@pytest.mark.parametrize(("clock_us", "since_1970"), [(10**15, False), (10**15 + 1, True)])
def test_stamps_after_2001_count_from_1970(clock_us: int, since_1970: bool) -> None:
    """No autopilot has run for the 31 years that they would be since its boot."""
    assert is_epoch(clock_us) is since_1970


@pytest.mark.parametrize(("clock_us", "accepted"), [(4 * 10**15, True), (4 * 10**15 + 1, False)])
def test_stamps_end_in_2096(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any], clock_us: int, accepted: bool
) -> None:
    message = mavlink_message("HIGHRES_IMU", clock_us, *IMU, 0x3F, 0)
    assert (samples.decode(message, 0.0) is not None) is accepted


def test_values_that_are_not_finite_and_impossible_stamps_are_refused(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    bad = (np.nan, *IMU[1:])
    assert samples.decode(mavlink_message("HIGHRES_IMU", 1, *bad, 0x3F, 0), 0.0) is None
    assert samples.decode(mavlink_message("HIGHRES_IMU", 2**63, *IMU, 0x3F, 0), 0.0) is None
    assert sorted(samples.refused) == [
        "HIGHRES_IMU: an impossible stamp",
        "HIGHRES_IMU: values that are not finite",
    ]


INFINITE = float("inf")


@pytest.mark.parametrize("value", [INFINITE, -INFINITE, float("nan")])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_an_attitude_that_is_not_finite_is_not_kept(
    value: float, samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    """A position after it would be turned and carried on by it."""
    local = mavlink_message("LOCAL_POSITION_NED", 1000, *[1.0] * 6)
    for place in range(6):
        fields = [0.1] * 6
        fields[place] = value
        assert samples.decode(mavlink_message("ATTITUDE", 1000, *fields), 0.0) is None
        assert samples.decode(local, 0.0) is None
    for place in range(4, 7):
        fields = [1.0, *[0.0] * 6]
        fields[place] = value
        assert samples.decode(mavlink_message("ATTITUDE_QUATERNION", 1000, *fields), 0.0) is None
        assert samples.decode(local, 0.0) is None
    assert samples.refused["ATTITUDE: values that are not finite"] == 6
    assert samples.refused["ATTITUDE_QUATERNION: values that are not finite"] == 3
    samples.decode(mavlink_message("ATTITUDE", 1000, *[0.1] * 6), 0.0)
    for place in range(3, 6):
        fields = [1.0] * 6
        fields[place] = value
        assert samples.decode(mavlink_message("LOCAL_POSITION_NED", 1000, *fields), 0.0) is None
    assert samples.decode(local, 0.0)


def test_an_infinite_velocity_is_not_a_missing_one(
    samples: MavlinkSamples, mavlink_message: Callable[..., Any]
) -> None:
    """Motion capture sends NaN where it has none."""
    assert samples.decode(odometry(mavlink_message, vx=INFINITE), 0.0) is None
    assert samples.decode(odometry(mavlink_message, vx=float("nan")), 0.0).topic == "mocap/pose"


def test_an_impossible_stamp_leaves_the_speeds_of_before(mavlink_message: Callable[..., Any]) -> None:
    samples = MavlinkSamples(None, RotorOrder((0, 1, 4, 5), "rpm"))

    def status(first: int, time_us: int) -> Sample | None:
        values = (first, time_us, [1000] * 4, [0.0] * 4, [0.0] * 4)
        return samples.decode(mavlink_message("ESC_STATUS", *values), 0.0)

    assert status(0, 1000) is None
    assert status(4, 2**63) is None
    assert status(4, 2000)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_no_payload_breaks_the_decoder(mavlink_sender: Any, data: st.DataObject) -> None:
    """Whatever bytes a packet of a known message carries, a sample is finite or there is none."""
    samples = MavlinkSamples(None, RotorOrder((0, 1, 2, 3), "rpm"))
    samples.autopilot = ARDUPILOT
    sender, framer, decoder = mavlink_sender(), Framer(), MessageDecoder()
    for _ in range(3):
        kind = sender.kinds[data.draw(st.sampled_from(sorted(samples.names)))]
        payload = data.draw(st.binary(min_size=1, max_size=kind.unpacker.size))
        for frame in framer.feed(sender.raw(kind, payload), complete=True):
            sample = samples.decode(decoder.decode(frame), 1.0)
            assert sample is None or np.isfinite(sample.values).all()
