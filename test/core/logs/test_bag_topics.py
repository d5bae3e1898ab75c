# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag by name: in a namespace, of a simulation, of any type."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import WindStream
from quadpi_core.logs.bag_topics import bag_vehicle, has_topic, topic_stamps
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.payloads import Payloads, Topic

from .bag_examples import assert_same_streams, imu_topic, write_ros1


def imu_alone(recording):
    return replace(recording, **dict.fromkeys(("rotor_speeds", "pose", "odometry", "wind")))


def test_topics_in_a_namespace_are_found(tmp_path, recording):
    path = tmp_path / "fleet.mcap"
    write_mcap(path, [imu_topic(recording, "/drone1/imu")], {})
    assert_same_streams(read_bag(path), imu_alone(recording))


@pytest.mark.parametrize("namespace", ["/truth", "/drone1/truth", "/truth/drone1"])
def test_truth_of_a_simulation_is_no_sensor(tmp_path, recording, namespace):
    path = tmp_path / "simulated.mcap"
    odometry = recording.odometry
    state = sensor_messages.pack_odometry(odometry)
    true_imu = imu_topic(recording, f"{namespace}/imu")
    true_state = Topic(f"{namespace}/odometry", sensor_messages.ODOMETRY, odometry.time_ns, state)
    write_mcap(path, [imu_topic(recording), true_imu, true_state], {})
    assert_same_streams(read_bag(path), imu_alone(recording))
    assert not has_topic(path, "odometry")


def test_truth_must_be_a_whole_topic_level(tmp_path, recording):
    path = tmp_path / "named.mcap"
    write_mcap(path, [imu_topic(recording, "/truthful/imu")], {})
    assert_same_streams(read_bag(path), imu_alone(recording))


def test_name_must_match_a_whole_topic_level(tmp_path, recording):
    path = tmp_path / "other.mcap"
    wind = sensor_messages.pack_wind(recording.wind)
    other = Topic("/side_wind", sensor_messages.WIND, recording.wind.time_ns, wind)
    write_mcap(path, [imu_topic(recording), other], {})
    assert read_bag(path).wind is None


def test_summary_lists_any_topic(tmp_path, recording):
    path = tmp_path / "any.mcap"
    text = codec("std_msgs/msg/String").encode(3, {"data": "hello"})
    log_time_ns = recording.imu.time_ns[0] + np.arange(3)
    write_bag(path, recording, [Topic("/chatter", "std_msgs/msg/String", log_time_ns, text)])
    stamps = topic_stamps(path)
    assert list(stamps) == ["/chatter", "/imu", "/mocap/pose", "/odometry", "/rotor_speeds", "/wind"]
    np.testing.assert_array_equal(stamps["/chatter"], log_time_ns)
    np.testing.assert_array_equal(stamps["/rotor_speeds"], recording.rotor_speeds.time_ns)


def test_topics_of_a_ros1_bag_have_their_header_stamps(tmp_path, sensor_topics):
    path = tmp_path / "flight.bag"
    write_ros1(path, sensor_topics)
    write_mcap(tmp_path / "flight.mcap", sensor_topics, {})
    np.testing.assert_equal(topic_stamps(path), topic_stamps(tmp_path / "flight.mcap"))


def test_a_stamp_that_is_none_is_named_by_its_place_in_the_topic(tmp_path):
    """A bag is looked through in blocks of 12 000 messages."""
    path, count = tmp_path / "long.mcap", 12_100
    wind = WindStream(np.arange(1, count + 1), np.zeros((count, 3)))
    payloads = list(sensor_messages.pack_wind(wind))
    payloads[12_050] = payloads[12_050][:8] + struct.pack("<I", 10**9) + payloads[12_050][12:]
    write_mcap(path, [Topic("/wind", sensor_messages.WIND, wind.time_ns, Payloads.join(payloads))], {})
    with pytest.raises(LogError, match=r"long\.mcap: topic /wind: sample 12050: the stamp has 1000000000 ns"):
        topic_stamps(path)


def test_a_topic_of_that_name_in_two_namespaces_is_ambiguous(tmp_path, recording):
    path = tmp_path / "fleet.mcap"
    write_mcap(path, [imu_topic(recording, "/a/imu"), imu_topic(recording, "/b/imu")], {})
    with pytest.raises(LogError, match=r"fleet\.mcap: topic imu: ambiguous between /a/imu, /b/imu"):
        has_topic(path, "imu")


def test_a_topic_of_another_type_is_refused(tmp_path, recording):
    path = tmp_path / "other.mcap"
    wrong = imu_topic(recording, "/wind")
    write_mcap(path, [wrong], {})
    with pytest.raises(
        LogError, match=r"topic /wind: type sensor_msgs/msg/Imu, expected geometry_msgs/msg/V"
    ):
        has_topic(path, "wind")


def test_motion_capture_s_odometry_is_no_estimator_s(tmp_path, recording):
    path = tmp_path / "mocap.mcap"
    state = sensor_messages.pack_odometry(recording.odometry)
    times = recording.odometry.time_ns
    write_mcap(path, [Topic("/mocap/odometry", sensor_messages.ODOMETRY, times, state)], {})
    assert (has_topic(path, "odometry"), has_topic(path, "mocap/odometry")) == (False, True)
    assert bag_vehicle(path) == ""
