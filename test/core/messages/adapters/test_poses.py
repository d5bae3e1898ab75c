# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.errors import LogError
from quadpi_core.frames import world_enu_to_ned
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.adapters import ADAPTERS, AdapterSettings
from quadpi_core.messages.adapters.adapter_settings import (
    FLU_ENU,
    FRD_NED,
    FUR_EUS,
    BodySettings,
    StateSettings,
)
from quadpi_core.messages.payloads import Payloads
from quadpi_core.rotations import rotation_matrix

N = 6
START_NS = 1_700_000_000_123_456_000
TIME_NS = START_NS + 8_000_000 * np.arange(N)
MOCAP = ("mocap4r2", "named_poses")
# Columns are forward, left and up of the body axes, and east, north and up of the world axes.
BODIES = {FLU_ENU: np.eye(3), FRD_NED: np.diag([1, -1, -1]), FUR_EUS: [[1, 0, 0], [0, 0, 1], [0, -1, 0]]}
WORLDS = {FLU_ENU: np.eye(3), FRD_NED: [[0, 1, 0], [1, 0, 0], [0, 0, -1]], FUR_EUS: BODIES[FUR_EUS]}


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def opened(vendor, name, body="quad", frames=FLU_ENU):
    adapter = ADAPTERS[name]
    settings = AdapterSettings(mocap=BodySettings(body, frames))
    return adapter.open(vendor.definition(adapter.type_name), settings, None)


def frame(vendor, name, time_ns, bodies):
    """One message with the bodies given as (name, position, orientation x y z w)."""
    header = vendor.header(time_ns)
    if name == "named_poses":
        kind = "motion_capture_tracking_interfaces/msg/NamedPose"
        poses = [vendor.make(kind, name=body, pose=vendor.pose(*pose)) for body, *pose in bodies]
        return vendor.bytes(vendor.make(f"{kind}Array", header=header, poses=poses))
    point = vendor.store.types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
    rigid = []
    for index, (body, *pose) in enumerate(bodies):
        marker = vendor.make("mocap4r2_msgs/msg/Marker", marker_name="m" * index, translation=point)
        rigid.append(
            vendor.make(
                "mocap4r2_msgs/msg/RigidBody",
                rigid_body_name=body,
                markers=[marker] * index,
                pose=vendor.pose(*pose),
            )
        )
    message = vendor.make("mocap4r2_msgs/msg/RigidBodies", header=header, frame_number=7, rigidbodies=rigid)
    return vendor.bytes(message)


@pytest.mark.parametrize("name", MOCAP)
@pytest.mark.parametrize("frames", [FLU_ENU, FRD_NED, FUR_EUS])
def test_poses_of_the_named_body_are_those_of_a_pose_message(vendor, rng, name, frames):
    """Whatever the axes, the stream is that of the same flight sent as geometry_msgs/PoseStamped."""
    vendor = vendor.px4_1_14
    position, rotation = rng.normal(size=(N, 3)), Rotation.random(N, rng)
    world, body = np.array(WORLDS[frames]), np.array(BODIES[frames])
    sent_position = position @ world.T
    sent = Rotation.from_matrix(world @ rotation.as_matrix() @ body.T).as_quat()
    payloads = []
    for sample in range(N):
        mine = ("quad", sent_position[sample], sent[sample])
        others = [("wand", [9, 9, 9], [0, 0, 0, 1]), ("quad2", [8, 8, 8], [0, 0, 0, 1])]
        bodies = [others[0], mine, others[1]] if sample % 2 else [mine, *others]
        payloads.append(frame(vendor, name, TIME_NS[sample], bodies))
    unpacker = opened(vendor, name, frames=frames)
    stream = unpacker.unpack(Payloads.join(payloads))
    assert stream.time_ns.tolist() == TIME_NS.tolist()
    np.testing.assert_allclose(stream.position, world_enu_to_ned(position), atol=1e-14)
    forward, up = (rotation.apply(axis) for axis in ([1, 0, 0], [0, 0, 1]))
    axes = rotation_matrix(stream.attitude)
    np.testing.assert_allclose(axes[:, :, 0], world_enu_to_ned(forward), atol=1e-14)
    np.testing.assert_allclose(-axes[:, :, 2], world_enu_to_ned(up), atol=1e-14)
    assert not unpacker.dropped
    again = sensor_messages.unpack_pose(sensor_messages.pack_pose(stream))
    np.testing.assert_allclose(again.position, stream.position)
    one = opened(vendor, name, frames=frames).unpack(payloads[3])
    np.testing.assert_array_equal(one.position[0], stream.position[3])


@pytest.mark.parametrize("name", MOCAP)
def test_hidden_bodies_give_no_pose(vendor, name):
    vendor = vendor.px4_1_14
    good = ("quad", [1, 2, 3], [0, 0, 0, 1])
    lost = [
        ("quad", [1, 2, 3], [np.nan] * 4),
        ("quad", [0, 0, 0], [0, 0, 0, 0]),
        ("quad", [np.nan, 0, 0], [0, 0, 0, 1]),
    ]
    frames = [[good], [], [lost[0]], [lost[1]], [lost[2]], [("wand", *good[1:])], [good]]
    payloads = [frame(vendor, name, START_NS + sample, bodies) for sample, bodies in enumerate(frames)]
    unpacker = opened(vendor, name)
    assert unpacker.unpack(Payloads.join(payloads)).time_ns.tolist() == [START_NS, START_NS + 6]
    assert sorted(unpacker.dropped.values()) == [2, 3]


@pytest.mark.parametrize("name", MOCAP)
def test_a_body_that_never_comes_names_the_others_and_a_name_that_comes_twice_is_refused(vendor, name):
    vendor = vendor.px4_1_14
    pose = ([1, 2, 3], [0, 0, 0, 1])
    unpacker = opened(vendor, name)
    assert len(unpacker.unpack(frame(vendor, name, START_NS, [("cf1", *pose), ("cf2", *pose)]))) == 0
    assert list(unpacker.dropped) == ["quad is not in it (others: cf1, cf2)"]
    twice = frame(vendor, name, START_NS, [("quad", *pose), ("quad", *pose)])
    with pytest.raises(LogError, match="sample 1: two bodies are named quad"):
        unpacker.unpack(Payloads.join([frame(vendor, name, START_NS, [("quad", *pose)]), twice]))


def px4_odometry(vendor, **changes):
    fields = {
        "timestamp": START_NS // 1000 + 500,
        "timestamp_sample": START_NS // 1000,
        "pose_frame": 1,
        "position": [1, 2, -3],
        "q": np.sqrt([0.5, 0, 0, 0.5]),
        "velocity_frame": 1,
        "velocity": [4, 5, 6],
        "angular_velocity": [0.1, 0.2, 0.3],
        "position_variance": [0, 0, 0],
        "orientation_variance": [0, 0, 0],
        "velocity_variance": [0, 0, 0],
        **changes,
    }
    arrays = {
        name: np.array(value, np.float32) if isinstance(value, list | np.ndarray) else value
        for name, value in fields.items()
    }
    return vendor.bytes(vendor.make("px4_msgs/msg/VehicleOdometry", **arrays))


def opened_px4(vendor, name):
    adapter = ADAPTERS[name]
    settings = AdapterSettings(odometry=StateSettings(), imu=StateSettings())
    return adapter.open(vendor.definition(adapter.type_name), settings, None)


@pytest.mark.parametrize("pose_frame", [1, 2])
def test_px4_odometry_is_stamped_when_sampled_with_its_velocity_in_the_body(vendor, pose_frame):
    """Yawed by 90° to the right, north is on the left."""
    vendor = vendor.px4_1_14
    unpacker = opened_px4(vendor, "px4_odometry")
    stream = unpacker.unpack(px4_odometry(vendor, pose_frame=pose_frame, velocity_frame=pose_frame))
    assert stream.time_ns.tolist() == [START_NS]
    np.testing.assert_allclose(stream.position, [[1, 2, -3]])
    np.testing.assert_allclose(stream.velocity, [[5, -4, 6]], rtol=1e-6)
    np.testing.assert_allclose(stream.rates, [[0.1, 0.2, 0.3]], rtol=1e-6)
    in_body = unpacker.unpack(px4_odometry(vendor, pose_frame=pose_frame, velocity_frame=3))
    np.testing.assert_allclose(in_body.velocity, [[4, 5, 6]])
    unsampled = unpacker.unpack(px4_odometry(vendor, timestamp_sample=0))
    assert unsampled.time_ns.tolist() == [START_NS + 500_000]


@pytest.mark.parametrize("field", ["position", "q", "velocity", "angular_velocity"])
def test_px4_odometry_without_a_quantity_is_no_sample(vendor, field):
    vendor = vendor.px4_1_14
    unpacker = opened_px4(vendor, "px4_odometry")
    unknown = px4_odometry(vendor, **{field: [np.nan] * (4 if field == "q" else 3)})
    stream = unpacker.unpack(Payloads.join([unknown, px4_odometry(vendor)]))
    assert len(stream) == 1
    assert sum(unpacker.dropped.values()) == 1


@pytest.mark.parametrize("frames", [(0, 1), (1, 0), (1, 2), (2, 1), (3, 3)])
def test_px4_odometry_in_frames_that_do_not_fit_is_refused(vendor, frames):
    vendor = vendor.px4_1_14
    wrong = px4_odometry(vendor, pose_frame=frames[0], velocity_frame=frames[1])
    with pytest.raises(LogError, match=f"sample 1: pose_frame {frames[0]}, velocity_frame {frames[1]}"):
        opened_px4(vendor, "px4_odometry").unpack(Payloads.join([px4_odometry(vendor), wrong]))


def test_stamps_that_no_message_can_hold_are_refused(vendor):
    vendor = vendor.px4_1_14
    beyond = px4_odometry(vendor, timestamp_sample=2**31 * 10**6)
    with pytest.raises(LogError, match="sample 0: the stamp has 2147483648000000 µs"):
        opened_px4(vendor, "px4_odometry").unpack(beyond)


def test_px4_imu_needs_no_conversion(vendor):
    vendor = vendor.px4_1_14
    message = vendor.make(
        "px4_msgs/msg/SensorCombined",
        timestamp=START_NS // 1000,
        gyro_rad=np.array([0.1, 0.2, 0.3], np.float32),
        accelerometer_m_s2=np.array([1, 2, -9.8], np.float32),
    )
    stream = opened_px4(vendor, "px4_imu").unpack(vendor.bytes(message))
    assert stream.time_ns.tolist() == [START_NS]
    np.testing.assert_allclose(stream.angular_velocity, [[0.1, 0.2, 0.3]], rtol=1e-6)
    np.testing.assert_allclose(stream.specific_force, [[1, 2, -9.8]], rtol=1e-6)
