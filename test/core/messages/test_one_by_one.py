# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Live messages in one buffer: the same samples and the same bytes as messages in blocks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import SampleError
from quadpi_core.flight import (
    AXES,
    ImuStream,
    OdometryStream,
    PoseStream,
    RotorSpeedStream,
    Stream,
    TwistStream,
    WindStream,
)
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.one_by_one import IncomingMessage, OutgoingMessage
from quadpi_core.results import PredictionRows, Predictions
from quadpi_core.vehicle import Vehicle

N = 7
VEHICLE = replace(Vehicle.load("neurobem"), pole_pairs=7)


def stream_of(kind: type[Stream], *widths: int) -> Any:
    rng = np.random.default_rng(1)
    columns = [rng.normal(size=(N, width)) for width in widths]
    if kind in (PoseStream, OdometryStream):
        columns[1] /= np.linalg.norm(columns[1], axis=1, keepdims=True)
    return kind(np.arange(N) * 1_999_999_999 + 5, *columns)


IMU = stream_of(ImuStream, 3, 3)
POSE = stream_of(PoseStream, 3, 4)
ODOMETRY = stream_of(OdometryStream, 3, 4, 3, 3)
WIND = stream_of(WindStream, 3)
ROTORS = stream_of(RotorSpeedStream, 4)
TWIST = TwistStream(IMU.time_ns, IMU.angular_velocity, np.arange(N) % 3 == 0)
KINDS = {
    "imu": (sensor_messages.IMU_SAMPLES, sensor_messages.pack_imu(IMU), sensor_messages.unpack_imu),
    "pose": (sensor_messages.POSE_SAMPLES, sensor_messages.pack_pose(POSE), sensor_messages.unpack_pose),
    "odometry": (
        sensor_messages.ODOMETRY_SAMPLES,
        sensor_messages.pack_odometry(ODOMETRY),
        sensor_messages.unpack_odometry,
    ),
    "wind": (sensor_messages.WIND_SAMPLES, sensor_messages.pack_wind(WIND), sensor_messages.unpack_wind),
    "rotor speeds": (
        sensor_messages.rotor_speed_samples(4),
        sensor_messages.pack_rotor_speeds(ROTORS),
        sensor_messages.unpack_rotor_speeds,
    ),
    "erpm": (
        sensor_messages.erpm_samples(VEHICLE),
        sensor_messages.pack_erpm(ROTORS.time_ns, ROTORS.speeds),
        lambda payloads: sensor_messages.unpack_erpm(payloads, VEHICLE),
    ),
    "twist": (
        sensor_messages.twist_samples("base_link"),
        sensor_messages.pack_twist(TWIST),
        sensor_messages.unpack_twist,
    ),
}


@pytest.mark.parametrize("name", KINDS)
def test_messages_in_turn_give_the_samples_of_a_block(name: str) -> None:
    kind, payloads, unpack = KINDS[name]
    read = IncomingMessage(kind)
    block, live = unpack(payloads), [read(message).take([0]) for message in payloads]
    for column, values in vars(block).items():
        np.testing.assert_array_equal(np.concatenate([getattr(one, column) for one in live]), values)


def test_the_next_message_overwrites_the_sample() -> None:
    read = IncomingMessage(sensor_messages.IMU_SAMPLES)
    messages = list(sensor_messages.pack_imu(IMU))
    first = read(messages[0])
    assert read(messages[1]) is first
    assert first.time_ns[0] == IMU.time_ns[1]


def damaged_stamp(message: bytes) -> bytes:
    return message[:8] + (2_000_000_000).to_bytes(4, "little") + message[12:]


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (damaged_stamp, "the stamp has 2000000000 ns"),
        (lambda message: message[:-9], "bytes where sensor_msgs/msg/Imu takes"),
        (lambda message: b"\x00\x00" + message[2:], "not little-endian CDR"),
        (lambda _: b"", "not little-endian CDR"),
    ],
)
def test_bytes_that_are_no_message_are_refused_and_the_next_one_is_read(
    damage: Callable[[bytes], bytes], reason: str
) -> None:
    read = IncomingMessage(sensor_messages.IMU_SAMPLES)
    messages = list(sensor_messages.pack_imu(IMU))
    for _ in range(2):
        with pytest.raises(SampleError, match=reason):
            read(damage(messages[0]))
        assert read(messages[1]).time_ns[0] == IMU.time_ns[1]


@pytest.mark.parametrize("name", ["rotor speeds", "erpm"])
@pytest.mark.parametrize("count", [3, 6])
def test_another_number_of_rotors_is_refused_by_name_and_the_next_message_is_read(
    name: str, count: int
) -> None:
    kind, payloads, _ = KINDS[name]
    read = IncomingMessage(kind)
    other = RotorSpeedStream(ROTORS.time_ns, np.ones((N, count)))
    wrong = {
        "rotor speeds": sensor_messages.pack_rotor_speeds(other),
        "erpm": sensor_messages.pack_erpm(other.time_ns, other.speeds),
    }[name][0]
    for _ in range(2):
        with pytest.raises(SampleError, match=f"sample 0: `\\w+` holds {count} values, expected 4"):
            read(wrong)
        assert read(payloads[1]).time_ns[0] == ROTORS.time_ns[1]


def test_a_length_that_is_not_that_of_the_numbers_is_refused() -> None:
    """All bytes but those of the length are those of the message before."""
    read = IncomingMessage(sensor_messages.rotor_speed_samples(4))
    message = sensor_messages.pack_rotor_speeds(ROTORS)[0]
    read(message)
    place = message.index((4).to_bytes(4, "little"))
    assert message.count((4).to_bytes(4, "little")) == 1
    for claimed in (0, 3, 5, 2**31):
        with pytest.raises(SampleError):
            read(message[:place] + claimed.to_bytes(4, "little") + message[place + 4 :])
    assert read(message).time_ns[0] == ROTORS.time_ns[0]


def test_an_orientation_that_is_none_is_refused() -> None:
    read = IncomingMessage(sensor_messages.POSE_SAMPLES)
    wrong = PoseStream(POSE.time_ns, POSE.position, 2.0 * POSE.attitude)
    with pytest.raises(SampleError, match="no unit quaternion"):
        read(sensor_messages.pack_pose(wrong)[0])


def test_padding_behind_the_names_changes_nothing() -> None:
    """Writers leave its bytes as they happen to be."""
    messages = list(sensor_messages.pack_imu(IMU, "imu_link"))
    place = messages[0].index(b"imu_link") + len("imu_link") + 1
    judged: list[tuple[str, ...]] = []
    read = IncomingMessage(sensor_messages.IMU_SAMPLES, judged.append)
    for byte, message in enumerate(messages):
        read(message[:place] + bytes([byte]) + message[place + 1 :])
    assert judged == [("imu_link",)]


def test_a_message_is_written_as_in_a_block() -> None:
    columns = [np.random.default_rng(2).normal(size=(N, 6)) for _ in range(5)]
    predictions = Predictions(IMU.time_ns, *columns)
    block = result_messages.pack_predictions(predictions, model="m", confidence=0.9, axes=AXES, frame_id="b")
    message = result_messages.prediction_message("m", 0.9, AXES, "b")
    assert result_messages.write_predictions(PredictionRows.from_predictions(predictions), message) == list(
        block
    )

    constants = sensor_messages.odometry_constants("map", "base_link")
    odometry = OutgoingMessage(codec(sensor_messages.ODOMETRY), constants)
    for packed, time_ns in zip(KINDS["odometry"][1], ODOMETRY.time_ns.tolist(), strict=True):
        odometry.values[:] = codec(sensor_messages.ODOMETRY).decode_stamped(packed)[1]
        assert odometry.stamped(time_ns) == packed
