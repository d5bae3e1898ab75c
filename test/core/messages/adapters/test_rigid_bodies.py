# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.errors import LogError
from quadpi_core.frames import rotation_matrix, world_enu_to_ned
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.adapters import AdapterSettings, known_adapters
from quadpi_core.messages.adapters.adapter_settings import (
    FLU_ENU,
    FRD_NED,
    FUR_EUS,
    BodySettings,
)
from quadpi_core.messages.payloads import Payloads

from .vendor_messages import START_NS, frame

N = 6
TIME_NS = START_NS + 8_000_000 * np.arange(N)
MOCAP = ("mocap4r2", "named_poses")
# Columns are forward, left and up of the body axes, and east, north and up of the world axes.
BODIES = {FLU_ENU: np.eye(3), FRD_NED: np.diag([1, -1, -1]), FUR_EUS: [[1, 0, 0], [0, 0, 1], [0, -1, 0]]}
WORLDS = {FLU_ENU: np.eye(3), FRD_NED: [[0, 1, 0], [1, 0, 0], [0, 0, -1]], FUR_EUS: BODIES[FUR_EUS]}


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def opened(vendor, name, body="quad", frames=FLU_ENU):
    adapter = known_adapters()[name]
    settings = AdapterSettings(mocap=BodySettings(body, frames))
    return adapter.open(vendor.definition(adapter.type_name), settings, None)


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


def test_of_many_other_bodies_nine_are_named(vendor):
    vendor = vendor.px4_1_14
    others = [(f"cf{number:02}", [1, 2, 3], [0, 0, 0, 1]) for number in range(30)]
    unpacker = opened(vendor, "named_poses")
    unpacker.unpack(Payloads.join([frame(vendor, "named_poses", START_NS + k, others) for k in range(2)]))
    named = ", ".join(f"cf{number:02}" for number in range(9))
    assert unpacker.dropped == {f"quad is not in it (others: {named})": 2}
