# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Sensor topics of a bag: named, of a standard name, of a known type, or refused with the options to give.

The bags are written by rosbags, as `ros2 bag record` writes them.
"""

import re

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, PoseStream
from quadpi_core.logs import read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_inputs import AS_FAST, find_inputs, holds_imu
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.adapters import AdapterSettings
from quadpi_core.messages.definitions import typestore
from quadpi_core.reading_options import ReadingOptions

from .bag_examples import assert_same_streams

IMU, POSE, TRANSFORM = sensor_messages.IMU, sensor_messages.POSE, sensor_messages.TRANSFORM
ODOMETRY, TF = sensor_messages.ODOMETRY, "tf2_msgs/msg/TFMessage"
ROTORS = sensor_messages.ROTOR_SPEEDS
IMU_ONLY = {"/imu": IMU}


def header(store, time_ns, frame="world"):
    second, nanosecond = divmod(int(time_ns), 10**9)
    stamp = store.types["builtin_interfaces/msg/Time"](sec=second, nanosec=nanosecond)
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def transforms(store, pose, child, parent="world"):
    """geometry_msgs/TransformStamped of poses, as vicon_bridge sends them."""
    types = store.types
    for time_ns, message in zip(pose.time_ns, sensor_messages.pack_pose(pose), strict=True):
        place = store.deserialize_cdr(message, POSE).pose
        p = place.position
        yield types[TRANSFORM](
            header=header(store, time_ns, parent),
            child_frame_id=child,
            transform=types["geometry_msgs/msg/Transform"](
                translation=types["geometry_msgs/msg/Vector3"](x=p.x, y=p.y, z=p.z),
                rotation=place.orientation,
            ),
        )


def payloads_of(recording, type_name, child="quad", parent="world"):
    """Stamps and messages of a type that hold what the recording does."""
    store, pose = typestore(), recording.pose
    match type_name:
        case sensor_messages.IMU:
            return recording.imu.time_ns, list(sensor_messages.pack_imu(recording.imu))
        case sensor_messages.POSE:
            return pose.time_ns, list(sensor_messages.pack_pose(pose))
        case sensor_messages.ODOMETRY:
            return recording.odometry.time_ns, list(sensor_messages.pack_odometry(recording.odometry))
        case sensor_messages.ROTOR_SPEEDS:
            return recording.rotor_speeds.time_ns, list(
                sensor_messages.pack_rotor_speeds(recording.rotor_speeds)
            )
        case sensor_messages.TRANSFORM:
            sent = [store.serialize_cdr(one, TRANSFORM) for one in transforms(store, pose, child, parent)]
            return pose.time_ns, list(map(bytes, sent))
        case "tf2_msgs/msg/TFMessage":
            both = zip(transforms(store, pose, child, parent), transforms(store, pose, "wand"), strict=True)
            # The other body is not in each message.
            kinds = [
                store.types[TF](transforms=[one] if n % 3 or child == "alone" else [other, one])
                for n, (one, other) in enumerate(both)
            ]
            return pose.time_ns, [bytes(store.serialize_cdr(one, TF)) for one in kinds]
        case "sensor_msgs/msg/JointState":
            empty = np.empty(0)
            one = store.types[type_name](header(store, 0), [], empty, empty, empty)
            return pose.time_ns, [bytes(store.serialize_cdr(one, type_name))] * len(pose)
    raise ValueError(type_name)


@pytest.fixture
def bag(tmp_path, recording):
    """bag({topic: type, …}, …) → a folder; a topic may stand for `(type, stride)` or `(type, 1, child)`."""

    def write(topics, storage=StoragePlugin.MCAP, **frames):
        path = tmp_path / f"bag{len(list(tmp_path.iterdir()))}"
        with Writer(path, version=9, storage_plugin=storage) as writer:
            for name, what in topics.items():
                type_name, stride = what if isinstance(what, tuple) else (what, 1)
                connection = writer.add_connection(name, type_name, typestore=typestore())
                stamps, payloads = payloads_of(recording, type_name, **frames)
                for time_ns, payload in zip(stamps[::stride], payloads[::stride], strict=True):
                    writer.write(connection, int(time_ns), payload)
        return path

    return write


def found(path, **settings):
    with Bag(path) as opened:
        return find_inputs(opened, AdapterSettings(**settings))


STANDARD = {"/mavros/imu/data": IMU, "/motors": sensor_messages.ROTOR_SPEEDS}


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize(
    ("topic", "type_name", "child"),
    [
        ("/vrpn_client_node/quad/pose", POSE, "quad"),
        ("/vicon/quad/quad", TRANSFORM, "quad"),
        ("/tf", TF, "alone"),
    ],
)
def test_other_names_are_found_by_type(bag, recording, topic, type_name, child, storage, caplog):
    path = bag({**STANDARD, topic: type_name}, storage, child=child)
    read = read_recording(path, None)
    np.testing.assert_allclose(read.pose.position, recording.pose.position, atol=1e-12)
    turn = np.abs(np.einsum("ni,ni->n", read.pose.attitude, recording.pose.attitude))
    np.testing.assert_allclose(turn, 1.0, atol=1e-12)
    assert len(read.imu) == len(recording.imu)
    assert len(read.rotor_speeds) == len(recording.rotor_speeds)
    assert holds_imu(path)
    notes = " ".join(caplog.messages)
    assert "/mavros/imu/data is read by its type" in notes
    assert topic in notes


def test_a_state_of_another_name_is_read_where_there_is_no_motion_capture(bag, recording):
    state = {"/mavros/local_position/odom": ODOMETRY}
    read = read_recording(bag({**IMU_ONLY, **state}), None)
    np.testing.assert_allclose(read.odometry.velocity, recording.odometry.velocity, atol=1e-12)
    read = read_recording(bag({**IMU_ONLY, **state, "/vrpn/quad/pose": POSE}), None)
    assert (read.odometry, len(read.pose)) == (None, len(recording.pose))


@pytest.mark.parametrize("name", ["setpoint_position/local", "local_position/pose", "vision_pose/pose"])
def test_what_an_autopilot_is_told_or_estimates_is_no_motion_capture(bag, name):
    path = bag({**IMU_ONLY, f"/mavros/{name}": POSE})
    assert set(found(path).names) == {"imu"}
    assert found(path, topics={"mocap/pose": f"/mavros/{name}"}).names["mocap/pose"] == f"/mavros/{name}"


def test_of_one_sensor_the_fastest_topic_is_read_then_data(bag):
    both = bag({"/mavros/imu/data_raw": IMU, "/mavros/imu/data": IMU})
    assert found(both).names == {"imu": "/mavros/imu/data"}
    (note,) = found(both).notes
    assert "before /mavros/imu/data_raw: the fastest, of equally fast ones `data`" in note
    slower = bag({"/mavros/imu/data_raw": IMU, "/mavros/imu/data": (IMU, 2)})
    assert found(slower).names == {"imu": "/mavros/imu/data_raw"}
    assert 0.5 < AS_FAST.value < 0.95


TWO = {
    "/uav1/mavros/imu/data": IMU,
    "/uav2/mavros/imu/data": IMU,
    "/vrpn/uav1/pose": POSE,
    "/vrpn/uav2/pose": POSE,
}


def test_two_vehicles_are_refused_with_the_line_to_paste_and_it_works(bag):
    path = bag(TWO)
    with pytest.raises(LogError) as refusal:
        found(path)
    line = str(refusal.value)
    assert "topic imu: ambiguous between /uav1/mavros/imu/data, /uav2/mavros/imu/data" in line
    advice = "`--namespace /uav1` or `--topics imu=/uav1/mavros/imu/data mocap/pose=/vrpn/uav1/pose`"
    assert line.endswith(f"choose with {advice}")
    topics = dict(re.findall(r"([\w/]+)=(\S+?)[ `]", advice))
    expected = {"imu": "/uav1/mavros/imu/data", "mocap/pose": "/vrpn/uav1/pose"}
    assert topics == expected
    assert found(path, topics=topics).names == found(path, namespace="/uav1").names == expected


@pytest.mark.parametrize(
    ("topics", "advice"),
    [
        # A namespace is offered only where it finds as much.
        ({"/uav1/imu": IMU, "/uav2/imu": IMU, "/vrpn/quad/pose": POSE}, "`--topics imu=/uav1/imu`"),
        ({"/camera/imu": IMU, "/mavros/imu/data": IMU, "/motors": ROTORS}, "`--topics imu=/camera/imu`"),
        ({"/vicon/quad/quad": TRANSFORM, "/vicon/b/b": TRANSFORM}, "`--topics mocap/pose=/vicon/b/b`"),
        (
            {"/uav1/imu": IMU, "/uav2/imu": IMU, "/tf": TF},
            "`--namespace /uav1` or `--topics imu=/uav1/imu mocap/transform=/tf:uav1/base`",
        ),
        (
            {"/uav1/mocap/pose": POSE, "/vrpn/uav2/pose": POSE, "/uav1/imu": IMU},
            "`--namespace /uav1` or `--topics mocap/pose=/uav1/mocap/pose`",
        ),
    ],
)
def test_each_line_to_paste_finds_the_same(bag, topics, advice):
    path = bag({**({} if "imu" in str(topics) else IMU_ONLY), **topics}, child="uav1/base")
    with pytest.raises(LogError) as refusal:
        found(path)
    assert str(refusal.value).endswith(f"choose with {advice}")
    kinds = set()
    for option in re.findall("`(.*?)`", advice):
        word, *values = option.split(" ")
        given = (
            {"namespace": values[0]}
            if word == "--namespace"
            else {"topics": dict(one.split("=") for one in values)}
        )
        inputs = found(path, **given)
        kinds.add((*sorted(inputs.names), *inputs.adapted))
    assert len(kinds) == 1


def test_what_could_be_a_sensor_that_is_lacking_is_named(bag):
    path = bag(
        {**IMU_ONLY, "/mavros/local_position/pose": POSE, "/joint_states": "sensor_msgs/msg/JointState"}
    )
    notes = " ".join(found(path).notes)
    line = "`--topics mocap/pose=/mavros/local_position/pose` reads"
    assert line in notes
    assert "topic /joint_states: sensor_msgs/msg/JointState is not understood, and not read" in notes
    other = bag({"/uav1/imu": IMU, "/rotors": ROTORS, "/vrpn/quad/pose": POSE})
    notes = " ".join(found(other, namespace="/uav1").notes)
    assert "`--topics rotor_speeds=/rotors`" in notes
    assert "`--topics mocap/pose=/vrpn/quad/pose`" in notes


@pytest.mark.parametrize(
    ("named", "refusal"),
    [
        (
            {"imu": "/uav3/imu"},
            r"topic /uav3/imu: named for imu, but the bag holds no such messages; topics of",
        ),
        (
            {"imu": "/vrpn/uav1/pose"},
            r"topic /vrpn/uav1/pose: named for imu, but is of type geometry_msgs/msg/PoseStamped; und",
        ),
        (
            {"mocap/pose": "/vrpn/uav1/pose", "mocap/odometry": "/vrpn/uav2/pose"},
            r"mocap/odometry=/vrpn/uav2/pose: is given but not used: mocap/pose is",
        ),
        ({"mocap/pose": "/vrpn/uav1/pose:quad"}, r"only a tf2_msgs/msg/TFMessage is read by a child frame"),
        ({"mocap/pose": "/tf"}, r"which is not said: `--topics mocap/pose=/tf:quad`, `--.*/tf:wand`"),
        (
            {"mocap/pose": "/tf:hook"},
            r"topic /tf: none of \d+ messages gives a sample \(\d+: hook is not in it",
        ),
    ],
)
def test_nothing_that_is_named_is_ignored(bag, named, refusal):
    path = bag({**TWO, "/tf": TF})
    with pytest.raises(LogError, match=refusal) as error:
        read_recording(path, None, ReadingOptions(topics={"imu": "/uav1/mavros/imu/data", **named}))
    assert str(path) in str(error.value)
    with pytest.raises(LogError, match=r"namespace /uav3: no topic of it; topics of the bag: /tf, /uav1/m"):
        found(path, namespace="/uav3")


def test_a_mapping_file_names_topics_of_standard_types(bag, tmp_path, recording):
    path, mapping = bag({**TWO, "/tf": TF}), tmp_path / "names.yaml"
    whole = "imu: {topic: /uav1/mavros/imu/data}\nmocap: {topic: /vrpn/uav2/pose}\n"
    same = "topics: {imu: /uav1/mavros/imu/data, mocap/pose: /vrpn/uav2/pose}\n"
    one = "namespace: /uav1\n"
    tf = "imu: {topic: /uav1/mavros/imu/data}\nmocap: {topic: /tf, body: quad, frames: flu-enu}\n"
    for text in (whole, same, one, tf):
        mapping.write_text(text)
        read = read_recording(path, None, mapping)
        assert [type(stream) for stream in read.streams()] == [ImuStream, PoseStream]
        assert len(read.pose) == len(recording.pose)
    for text, refusal in (
        (whole.replace("/vrpn/uav2/pose}", "/vrpn/uav2/pose, body: quad}"), "`body` is given but not used"),
        (whole + "topics: {imu: /uav2/mavros/imu/data}", "is given but not used: the mapping's imu"),
        ("topics: {imus: /uav1/imu}", r"names\.yaml: .*unknown key `imus`.*imu"),
        ("topics: {imu: 3}", r"names\.yaml: .*imu: must be the name of a topic"),
    ):
        mapping.write_text(text)
        with pytest.raises(LogError, match=refusal):
            read_recording(path, None, mapping)
    # The command line counts before the file.
    mapping.write_text(same)
    chosen = ReadingOptions(mapping, {"mocap/transform": "/tf:wand"})
    assert len(read_recording(path, None, chosen).pose) < len(recording.pose)


@pytest.mark.parametrize("type_name", [TRANSFORM, TF])
def test_a_world_that_says_z_down_is_refused(bag, type_name):
    path = bag({**IMU_ONLY, "/body": type_name}, parent="map_ned", child="alone")
    with pytest.raises(LogError, match="topic /body: sample 0: the frame `map_ned` says north-east-down"):
        read_recording(path, None)


def test_standard_names_count_before_types(bag, recording):
    path = bag({"/imu": IMU, "/camera/data": IMU, "/mocap/pose": POSE, "/vrpn/wand/pose": POSE})
    read = read_recording(path, None)
    kept = {"rotor_speeds": None, "odometry": None, "wind": None}
    assert_same_streams(read, type(recording)(**{**vars(recording), **kept}))
    imu, mocap = found(path).notes
    assert imu == "topic imu: /imu is read by its name, before /camera/data"
    assert mocap == "topic mocap/pose: /mocap/pose is read by its name, before /vrpn/wand/pose"
