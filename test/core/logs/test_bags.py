# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import hashlib
from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import (
    AXES,
    ImuStream,
    OdometryStream,
    PoseStream,
    Recording,
    RotorSpeedStream,
    WindStream,
)
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs import read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_topics import bag_topics, has_topic
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic, read_bag, read_outputs, write_bag
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.payloads import Topic
from quadpi_core.monitor.alarm_log import reasons_by_row
from quadpi_core.results import Alarms, Predictions
from quadpi_core.vehicle import Vehicle

N = 40
START_NS = 1_700_000_000_000_000_000


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.fixture
def recording(rng, tmp_path):
    source = tmp_path / "flight.csv"
    source.write_text("a log\n")
    time_ns = START_NS + np.arange(N) * 2_000_000
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (N, 1))
    return Recording(
        name="flight",
        vehicle="bebop2",
        source=str(source),
        imu=ImuStream(time_ns, rng.normal(size=(N, 3)), rng.normal(size=(N, 3))),
        rotor_speeds=RotorSpeedStream(time_ns + 300, rng.uniform(0, 900, size=(N, 4))),
        pose=PoseStream(time_ns[::4], rng.normal(size=(N // 4, 3)), attitude[::4]),
        odometry=OdometryStream(time_ns, *(rng.normal(size=(N, 3)), attitude, *rng.normal(size=(2, N, 3)))),
        wind=WindStream(time_ns[:2], rng.normal(size=(2, 3))),
    )


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


def assert_same_streams(actual, expected):
    assert [type(stream) for stream in actual.streams()] == [type(stream) for stream in expected.streams()]
    for one, other in zip(actual.streams(), expected.streams(), strict=True):
        for column in fields(other):
            np.testing.assert_allclose(
                getattr(one, column.name), getattr(other, column.name), rtol=1e-15, atol=1e-15
            )


def imu_topic(recording, name="/imu"):
    return Topic(name, sensor_messages.IMU, recording.imu.time_ns, sensor_messages.pack_imu(recording.imu))


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


def test_topics_in_a_namespace_are_found(tmp_path, recording):
    path = tmp_path / "fleet.mcap"
    write_mcap(path, [imu_topic(recording, "/drone1/imu")], {})
    assert_same_streams(read_bag(path), replace(recording, **dict.fromkeys(OPTIONAL)))


@pytest.mark.parametrize("namespace", ["/truth", "/drone1/truth", "/truth/drone1"])
def test_truth_of_a_simulation_is_no_sensor(tmp_path, recording, namespace):
    path = tmp_path / "simulated.mcap"
    odometry = recording.odometry
    state = sensor_messages.pack_odometry(odometry)
    true_imu = imu_topic(recording, f"{namespace}/imu")
    true_state = Topic(f"{namespace}/odometry", sensor_messages.ODOMETRY, odometry.time_ns, state)
    write_mcap(path, [imu_topic(recording), true_imu, true_state], {})
    assert_same_streams(read_bag(path), replace(recording, **dict.fromkeys(OPTIONAL)))
    assert not has_topic(path, "odometry")


def test_truth_must_be_a_whole_topic_level(tmp_path, recording):
    path = tmp_path / "named.mcap"
    write_mcap(path, [imu_topic(recording, "/truthful/imu")], {})
    assert_same_streams(read_bag(path), replace(recording, **dict.fromkeys(OPTIONAL)))


OPTIONAL = ("rotor_speeds", "pose", "odometry", "wind")


def test_name_must_match_a_whole_topic_level(tmp_path, recording):
    path = tmp_path / "other.mcap"
    write_mcap(path, [imu_topic(recording, "/raw_imu")], {})
    with pytest.raises(LogError, match=r"other\.mcap: topic imu: missing; topics of the bag: /raw_imu"):
        read_bag(path)


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
        *np.zeros((2, N, 3), np.uint8),
        np.zeros((N, 3)),
        *np.zeros((6, N, 6)),
        excess,
        excess,
        np.zeros(N, np.int64),
    )
    packed = result_messages.pack_predictions(predictions, model="m", confidence=0.95, axes=AXES)
    write_bag(
        path,
        recording,
        [
            output_topic("prediction", time_ns, packed),
            output_topic(
                "extrapolation_alarm", time_ns, result_messages.pack_alarms(alarms, reasons_by_row(alarms))
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


def test_summary_lists_any_topic(tmp_path, recording):
    path = tmp_path / "any.mcap"
    text = codec("std_msgs/msg/String").encode(3, {"data": "hello"})
    log_time_ns = START_NS + np.arange(3)
    write_bag(path, recording, [Topic("/chatter", "std_msgs/msg/String", log_time_ns, text)])
    summary = {topic.name: topic for topic in bag_topics(path)}
    assert sorted(summary) == ["/chatter", "/imu", "/mocap/pose", "/odometry", "/rotor_speeds", "/wind"]
    assert not summary["/chatter"].has_header
    np.testing.assert_array_equal(summary["/chatter"].stamps_ns, log_time_ns)
    assert summary["/rotor_speeds"].has_header
    assert summary["/rotor_speeds"].type_name == "quadpi/msg/RotorSpeeds"
    np.testing.assert_array_equal(summary["/rotor_speeds"].stamps_ns, recording.rotor_speeds.time_ns)


def test_real_flight_survives_the_bag(tmp_path, shared_data):
    flight = read_recording(sorted((shared_data / "neurobem").glob("*.mat"))[0], None)
    write_bag(tmp_path / "real.mcap", flight)
    assert_same_streams(read_bag(tmp_path / "real.mcap"), flight)
