# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Every bad bag gives one LogError of one line that names file, topic and sample, or reads unchanged."""

import re
from dataclasses import fields, replace

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.logs import read_recording
from quadpi_core.logs.bag_topics import topic_stamps
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.payloads import Payloads, Topic

N = 200
FLIPS = 40


@pytest.fixture(scope="module")
def recording():
    rng = np.random.default_rng(2)
    time_ns = 1_700_000_000_000_000_000 + np.arange(N) * 2_000_000
    return Recording(
        name="flight",
        vehicle="bebop2",
        source="",
        imu=ImuStream(time_ns, rng.normal(size=(N, 3)), rng.normal(size=(N, 3))),
        rotor_speeds=RotorSpeedStream(time_ns, rng.uniform(0, 900, size=(N, 4))),
        pose=PoseStream(time_ns, rng.normal(size=(N, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (N, 1))),
    )


@pytest.fixture
def bag(tmp_path, recording):
    path = tmp_path / "flight.mcap"
    write_bag(path, recording)
    return path


def assert_refused(path, pattern, read=read_bag):
    with pytest.raises(LogError, match=pattern) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))


def imu_with(recording, **changes):
    return replace(recording, imu=replace(recording.imu, **changes))


def test_absent(tmp_path):
    assert_refused(tmp_path / "nowhere.mcap", "no such bag")


def test_empty_file(bag):
    bag.write_bytes(b"")
    assert_refused(bag, "is empty")


def test_not_a_bag(bag):
    bag.write_bytes(b"time,ax,ay\n" * 20)
    assert_refused(bag, "is no MCAP file")


def test_a_folder_of_one_file_needs_no_metadata(bag):
    assert len(read_bag(bag.parent).imu) == N


def test_a_folder_of_several_files_needs_metadata(bag):
    bag.with_name("second.mcap").write_bytes(bag.read_bytes())
    assert_refused(bag.parent, "no metadata.yaml, and 2 files of messages: `ros2 bag reindex` makes it")


@pytest.mark.parametrize("fraction", [0.0001, 0.3, 0.9, 0.99])
def test_cut_off_anywhere(bag, fraction):
    whole = bag.read_bytes()
    bag.write_bytes(whole[: max(8, int(fraction * len(whole)))])
    assert_refused(bag, r"cut off, it has no footer; \d+ whole messages can be read")
    assert_refused(bag, "cut off", topic_stamps)


def test_cut_off_behind_the_data_counts_every_message(bag):
    bag.write_bytes(bag.read_bytes()[:-8])
    assert_refused(bag, f"no footer; {3 * N} whole messages can be read")


def test_missing_imu(tmp_path, recording):
    path = tmp_path / "no_imu.mcap"
    rotors = recording.rotor_speeds
    payloads = sensor_messages.pack_rotor_speeds(rotors)
    write_mcap(path, [Topic("/rotor_speeds", sensor_messages.ROTOR_SPEEDS, rotors.time_ns, payloads)], {})
    assert_refused(path, "topic imu: missing; topics of the bag: /rotor_speeds")


def test_missing_rotor_speeds_are_left_to_whoever_needs_them(tmp_path, recording):
    path = tmp_path / "no_rotors.mcap"
    write_bag(path, replace(recording, rotor_speeds=None))
    assert read_bag(path).rotor_speeds is None


@pytest.mark.parametrize("count", [1, 3, 6])
def test_another_number_of_rotors_than_the_vehicle_has(tmp_path, recording, count):
    """From a message on: the ones before are as they should be."""
    path = tmp_path / "rotors.mcap"
    rotors, first = recording.rotor_speeds, 7
    other = RotorSpeedStream(rotors.time_ns[first:], np.ones((len(rotors) - first, count)))
    payloads = Payloads.concatenate(
        [
            sensor_messages.pack_rotor_speeds(rotors.take(slice(0, first))),
            sensor_messages.pack_rotor_speeds(other),
        ]
    )
    imu = sensor_messages.pack_imu(recording.imu)
    topics = [
        Topic("/imu", sensor_messages.IMU, recording.imu.time_ns, imu),
        Topic("/uav/rotor_speeds", sensor_messages.ROTOR_SPEEDS, rotors.time_ns, payloads),
    ]
    write_mcap(path, topics, {})
    expected = f"topic /uav/rotor_speeds: sample {first}: `rotor_speeds` holds {count} values, expected 4"
    assert_refused(path, expected)


def test_wrong_type_on_a_topic(tmp_path, recording):
    path = tmp_path / "wrong.mcap"
    payloads = sensor_messages.pack_pose(recording.pose)
    write_mcap(path, [Topic("/imu", sensor_messages.POSE, recording.pose.time_ns, payloads)], {})
    assert_refused(path, "topic /imu: type geometry_msgs/msg/PoseStamped, expected sensor_msgs/msg/Imu")


def test_ambiguous_topic(tmp_path, recording):
    path = tmp_path / "two.mcap"
    payloads = sensor_messages.pack_imu(recording.imu)
    names = ("/a/imu", "/b/imu")
    write_mcap(
        path, [Topic(name, sensor_messages.IMU, recording.imu.time_ns, payloads) for name in names], {}
    )
    assert_refused(path, "topic imu: ambiguous between /a/imu, /b/imu")


def test_bytes_of_another_type_name_the_sample(tmp_path, recording):
    path = tmp_path / "mixed.mcap"
    payloads = sensor_messages.pack_pose(recording.pose)
    write_mcap(path, [Topic("/imu", sensor_messages.IMU, recording.pose.time_ns, payloads)], {})
    assert_refused(path, r"topic /imu: sample 0: .*sensor_msgs/msg/Imu")


def test_mostly_nan_names_the_sample(tmp_path, recording):
    path = tmp_path / "nan.mcap"
    specific_force = recording.imu.specific_force.copy()
    specific_force[17:, 2] = np.nan
    write_bag(path, imu_with(recording, specific_force=specific_force))
    assert_refused(
        path, "topic imu: sample 17: the specific_force is not finite", lambda bag: read_recording(bag, None)
    )


@pytest.mark.parametrize("shift_ns", [0, -1_000_000])
def test_stamps_that_stand_still_name_the_sample(tmp_path, recording, shift_ns):
    path = tmp_path / "unsorted.mcap"
    time_ns = recording.imu.time_ns.copy()
    time_ns[23:] = time_ns[22] + shift_ns
    payloads = sensor_messages.pack_imu(replace(recording.imu, time_ns=time_ns))
    write_mcap(path, [Topic("/imu", sensor_messages.IMU, recording.imu.time_ns, payloads)], {})
    assert_refused(path, "topic imu: sample 2[34]: the stamp repeats", lambda bag: read_recording(bag, None))


def read_or_refuse(bag):
    """The recording, or None for a LogError of one line that begins with the path."""
    try:
        return read_bag(bag)
    except LogError as error:
        return None if re.fullmatch(rf"{re.escape(str(bag))}: .+", str(error)) else error


def flipped_bytes(whole, seed):
    rng = np.random.default_rng(seed)
    for position in rng.integers(0, len(whole), FLIPS):
        flipped = bytearray(whole)
        flipped[position] ^= int(rng.integers(1, 256))
        yield flipped


@pytest.mark.slow
def test_no_flipped_byte_goes_unnoticed(bag, recording):
    """A flip is refused, or lies where it changes no sample."""
    refused = 0
    for flipped in flipped_bytes(bag.read_bytes(), seed=7):
        bag.write_bytes(flipped)
        found = read_or_refuse(bag)
        if found is None:
            refused += 1
            continue
        for stream, original in zip(found.streams(), recording.streams(), strict=True):
            for column in fields(original):
                np.testing.assert_allclose(
                    getattr(stream, column.name), getattr(original, column.name), rtol=1e-15, atol=1e-15
                )
    assert refused > FLIPS / 2


@pytest.mark.slow
def test_flipped_bytes_in_a_bag_without_checksums_raise_nothing_else(tmp_path, recording):
    with Writer(tmp_path / "folder", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/imu", sensor_messages.IMU, typestore=typestore())
        for time_ns, payload in zip(
            recording.imu.time_ns.tolist(), sensor_messages.pack_imu(recording.imu), strict=True
        ):
            writer.write(connection, time_ns, payload)
    bag = tmp_path / "folder" / "folder.mcap"
    for flipped in flipped_bytes(bag.read_bytes(), seed=8):
        bag.write_bytes(flipped)
        assert isinstance(read_or_refuse(bag), Recording | None)
