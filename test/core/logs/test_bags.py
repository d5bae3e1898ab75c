# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings in bags, and their topics by name: in a namespace, of a simulation, of any type."""

import hashlib
import struct
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import (
    AXES,
    WindStream,
)
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs import read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_topics import bag_vehicle, has_topic, topic_stamps
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic, read_bag, read_outputs, write_bag
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.monitor.alarm_log import Explained
from quadpi_core.monitor.change import found_columns, nothing_found
from quadpi_core.results import Alarms, Predictions
from quadpi_core.vehicle import Vehicle

from .bag_examples import assert_same_streams, imu_topic, write_ros1

N = 40


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.fixture
def vehicle():
    return Vehicle(
        name="twelve_poles",
        mass_kg=1.0,
        inertia=np.eye(3),
        rotor_radius_m=0.1,
        rotor_positions=np.zeros((4, 3)),
        rotor_spins=np.ones(4),
        pole_pairs=6,
        rotor_speed_max_rad_s=1000.0,
    )


def test_round_trip_with_provenance(tmp_path, recording):
    path = tmp_path / "out" / "flight.mcap"
    write_bag(path, recording)
    found = read_bag(path)
    assert_same_streams(found, recording)
    assert (found.name, found.vehicle, found.source) == ("flight", "bebop2", str(path))
    with Bag(path) as bag:
        assert bag.metadata["source"] == "flight.csv"
        assert bag.metadata["source_sha256"] == hashlib.sha256(b"a log\n").hexdigest()


def test_stamps_come_from_headers_not_from_log_times(tmp_path, recording):
    path = tmp_path / "late.mcap"
    late = replace(imu_topic(recording), log_time_ns=recording.imu.time_ns + 5_000_000_000)
    write_mcap(path, [late], {})
    np.testing.assert_array_equal(read_bag(path).imu.time_ns, recording.imu.time_ns)


OPTIONAL = ("rotor_speeds", "pose", "odometry", "wind")


def test_erpm_is_converted_with_the_pole_pairs(tmp_path, recording, vehicle, rng):
    path = tmp_path / "electrical.mcap"
    erpm = rng.uniform(1e4, 5e4, size=(N, 4))
    electrical = output_topic(
        "erpm", recording.imu.time_ns, sensor_messages.pack_erpm(recording.imu.time_ns, erpm)
    )
    write_bag(path, replace(recording, vehicle="", rotor_speeds=None), [electrical])
    found = read_bag(path, vehicle)
    np.testing.assert_allclose(found.rotor_speeds.speeds, erpm * 2 * np.pi / 60 / 6)
    assert found.vehicle == "twelve_poles"
    with pytest.raises(LogError, match=r"electrical\.mcap: topic /erpm: .* need the vehicle"):
        read_bag(path)


def test_outputs_of_the_monitor(tmp_path, recording, rng):
    path = tmp_path / "replayed.mcap"
    time_ns = recording.imu.time_ns
    predicted = rng.normal(size=(N, 6))
    predictions = Predictions(
        time_ns, predicted, predicted - 1.0, predicted + 1.0, predicted + 0.5, np.ones((N, 6))
    )
    excess = np.zeros((N, len(INPUT_NAMES)))
    excess[N // 2 :, INPUT_NAMES.index("u")] = 0.1
    alarms = Alarms(
        time_ns,
        np.full(N, 2, np.uint8),
        np.full(N, 1, np.uint8),
        *np.zeros((2, N, 4), np.uint8),
        np.zeros((N, 4)),
        *np.zeros((4, N, 6)),
        *found_columns(nothing_found(N), None).values(),
        *np.zeros((2, N, 6)),
        excess,
        excess,
        np.zeros(N, np.int64),
        np.zeros((N, 2), np.int64),
        *np.zeros((2, N), np.int64),
        np.zeros(N),
    )
    packed = result_messages.pack_predictions(predictions, model="m", confidence=0.95, axes=AXES)
    write_bag(
        path,
        recording,
        [
            output_topic("prediction", time_ns, packed),
            output_topic(
                "extrapolation_alarm", time_ns, result_messages.pack_alarms(alarms, Explained().rows(alarms))
            ),
        ],
    )
    found_predictions, found_alarms = read_outputs(path)
    np.testing.assert_array_equal(found_predictions.lower, predictions.lower)
    assert found_alarms.inputs_outside == [()] * (N // 2) + [("u",)] * (N - N // 2)
    assert_same_streams(read_bag(path), recording)


def test_bag_without_outputs(tmp_path, recording):
    path = tmp_path / "plain.mcap"
    write_bag(path, recording)
    assert read_outputs(path) == (None, None)


def test_real_flight_survives_the_bag(tmp_path, shared_data):
    flight = read_recording(sorted((shared_data / "neurobem").glob("*.mat"))[0], None)
    write_bag(tmp_path / "real.mcap", flight)
    assert_same_streams(read_bag(tmp_path / "real.mcap"), flight)


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
