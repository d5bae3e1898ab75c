# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that name other frames than they are read in: turned, refused or warned of; live as in bags."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError, SampleError
from quadpi_core.flight import ImuStream, OdometryStream, PoseStream
from quadpi_core.frames import rotation_matrix
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic, read_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.frame_ids import TF_TYPE, BodyFrames, Framed, StaticTransforms
from quadpi_core.messages.mounting import LAG_S, Mounting
from quadpi_core.messages.one_by_one import IncomingMessage
from quadpi_core.messages.payloads import Payloads, Topic

START_NS = 1_700_000_000_000_000_000
# A half turn about z, as of a board that is mounted backward, then that board's place.
BACKWARD, PLACE = (0.0, 0.0, 0.0, 1.0), (0.1, 0.02, -0.03)


def imu(count: int = 50) -> ImuStream:
    rng = np.random.default_rng(3)
    time_ns = START_NS + 2_000_000 * np.arange(count)
    return ImuStream(time_ns, rng.standard_normal((count, 3)), 9.0 + rng.standard_normal((count, 3)))


def transforms(*links: tuple[str, str, tuple[float, ...], tuple[float, ...]]) -> bytes:
    """A serialized tf2_msgs/TFMessage of parent, child, quaternion (w first) and translation."""
    types = typestore().types
    stamp, header = types["builtin_interfaces/msg/Time"](0, 0), types["std_msgs/msg/Header"]
    quaternion, vector = types["geometry_msgs/msg/Quaternion"], types["geometry_msgs/msg/Vector3"]
    stamped = [
        types["geometry_msgs/msg/TransformStamped"](
            header(stamp, parent),
            child,
            types["geometry_msgs/msg/Transform"](vector(*place), quaternion(*turn[1:], turn[0])),
        )
        for parent, child, turn, place in links
    ]
    return bytes(typestore().serialize_cdr(types[TF_TYPE](stamped), TF_TYPE))


@pytest.fixture
def bag(tmp_path: Path) -> Callable[..., Path]:
    def write(imu_frame: str, pose_frame: str = "map", *links: tuple) -> Path:
        stream = imu()
        pose = PoseStream(stream.time_ns, np.zeros((50, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (50, 1)))
        topics = [
            output_topic("imu", stream.time_ns, sensor_messages.pack_imu(stream, imu_frame)),
            output_topic("mocap/pose", pose.time_ns, sensor_messages.pack_pose(pose, pose_frame)),
        ]
        if links:
            topics.append(
                Topic("/tf_static", TF_TYPE, stream.time_ns[:1], Payloads.join([transforms(*links)]))
            )
        write_mcap(tmp_path / "bag.mcap", topics, {})
        return tmp_path / "bag.mcap"

    return write


@pytest.mark.parametrize("frame", ["base_link", "", "/base_link", "uav1/base_link"])
def test_the_body_is_the_body(bag: Callable[..., Path], frame: str, caplog: pytest.LogCaptureFixture) -> None:
    recording = read_bag(bag(frame))
    np.testing.assert_array_equal(recording.imu.specific_force, imu().specific_force)
    assert not caplog.records


def test_an_imu_elsewhere_is_moved_by_the_static_transforms_of_the_bag(bag: Callable[..., Path]) -> None:
    level = (1.0, 0.0, 0.0, 0.0)
    links = (("base_link", "plate", BACKWARD, (0.0, 0.0, 0.0)), ("plate", "imu_link", level, PLACE))
    found, there = read_bag(bag("imu_link", "map", *links)).imu, imu()
    # Backward and in FRD: x and y change their signs.
    turned = np.array([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(found.angular_velocity, turned * there.angular_velocity, atol=1e-12)
    arm = np.array([-0.1, 0.02, 0.03])
    omega = found.angular_velocity[0]
    expected = turned * there.specific_force[0] - np.cross(omega, np.cross(omega, arm))
    np.testing.assert_allclose(found.specific_force[0], expected, atol=1e-12)


def test_forward_right_down_is_half_a_turn(bag: Callable[..., Path]) -> None:
    found = read_bag(bag("base_link_FRD")).imu
    half_turn = np.array([1.0, -1.0, -1.0])
    np.testing.assert_array_equal(found.specific_force, half_turn * imu().specific_force)
    np.testing.assert_array_equal(found.angular_velocity, half_turn * imu().angular_velocity)


def test_an_unknown_frame_is_taken_as_the_body_with_one_warning(
    bag: Callable[..., Path], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        found = read_bag(bag("imu_link")).imu
    np.testing.assert_array_equal(found.specific_force, imu().specific_force)
    (record,) = caplog.records
    assert "bag.mcap: topic imu: the frame `imu_link` is not the body's, `base_link`" in record.getMessage()


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        (
            ("base_link", "map_ned"),
            r"bag\.mcap: topic /mocap/pose: sample 0: the frame `map_ned` says north-east",
        ),
        (
            ("base_link", "odom/NED"),
            r"topic /mocap/pose: sample 0: the frame `odom/NED` says north-east-down",
        ),
        *(
            (("base_link", name), f"sample 0: the frame `{name}` says north-east-down")
            for name in ("ned_world", "odomNED", "local_ned_frame", "uav1/nedMap", "north_east_down")
        ),
        (
            ("imu_ned", "map"),
            r"bag\.mcap: topic /imu: sample 0: the frame `imu_ned` of an IMU says north-east",
        ),
    ],
)
def test_north_east_down_is_refused(bag: Callable[..., Path], frames: tuple[str, str], reason: str) -> None:
    with pytest.raises(LogError, match=reason):
        read_bag(bag(*frames))


@pytest.mark.parametrize("frame", ["tuned", "planned_map", "map", "ned/map", "NEDry_lab", "kennedy"])
def test_a_name_that_only_ends_alike_is_no_ned(bag: Callable[..., Path], frame: str) -> None:
    assert read_bag(bag("base_link", frame)).pose is not None


def test_strict_refuses_what_nothing_is_known_of() -> None:
    frames = BodyFrames("base_link", strict=True)
    unpack = IncomingMessage(sensor_messages.IMU_SAMPLES, frames.imu, frames)
    foreign = sensor_messages.pack_imu(imu(1), "imu_link")[0]
    with pytest.raises(
        SampleError, match="`imu_link` is not the body's, `base_link`, and no static transform"
    ):
        unpack(foreign)
    with pytest.raises(SampleError, match="`imu_frd` is not"):
        unpack(sensor_messages.pack_imu(imu(1), "imu_frd")[0])
    unpack(sensor_messages.pack_imu(imu(1), "base_link_frd")[0])
    frames.transforms.take(transforms(("base_link", "imu_link", BACKWARD, PLACE)))
    assert unpack(foreign).specific_force[0, 0] == pytest.approx(-imu(1).specific_force[0, 0], abs=1.0)


@pytest.mark.parametrize("blocks", [1, 3, 50])
def test_a_displaced_imu_gives_the_same_samples_in_any_blocks(blocks: int) -> None:
    """Its derivative goes on when other transforms come, or another driver sends in between."""
    stream, frames = imu(), BodyFrames()
    names = np.where(np.arange(len(stream)) % 100 == 30, "base_link", "imu_link")
    names[-20:] = "x_frd"
    parts = [sensor_messages.pack_imu(stream.take([row]), str(name)) for row, name in enumerate(names)]
    payloads = Payloads.concatenate(parts)
    frames.transforms.take(transforms(("base_link", "imu_link", BACKWARD, PLACE)))
    whole = Framed(sensor_messages.unpack_imu, frames.imu)(payloads).specific_force
    in_blocks = Framed(sensor_messages.unpack_imu, frames.imu)
    live = IncomingMessage(sensor_messages.IMU_SAMPLES, frames.imu, frames)
    for rows in np.array_split(np.arange(len(stream)), blocks):
        part = in_blocks(Payloads.join([payloads[int(row)] for row in rows]))
        np.testing.assert_array_equal(part.specific_force, whole[rows])
        frames.transforms.take(transforms(("base_link", "camera", BACKWARD, PLACE)))
        for row in rows:
            np.testing.assert_array_equal(live(payloads[int(row)]).specific_force[0], whole[row])


def test_live_waits_a_moment_for_a_transform_then_goes_on_without() -> None:
    told: list[str] = []
    frames = BodyFrames("base_link", patience_s=0.05, warn=told.append)
    unpack = IncomingMessage(sensor_messages.IMU_SAMPLES, frames.imu, frames)
    foreign = sensor_messages.pack_imu(imu(1), "imu_link")[0]
    with pytest.raises(SampleError, match="waiting for a static transform"):
        unpack(foreign)
    while not told:
        with suppress(SampleError):
            unpack(foreign)
    assert len(told) == 1


def test_a_child_frame_with_z_down_is_refused() -> None:
    frames = BodyFrames()
    unpack = IncomingMessage(sensor_messages.ODOMETRY_SAMPLES, frames.world)
    one = OdometryStream(
        np.array([START_NS]),
        np.zeros((1, 3)),
        np.array([[1.0, 0.0, 0.0, 0.0]]),
        np.zeros((1, 3)),
        np.zeros((1, 3)),
    )
    for world, child in (("odom", "base_link"), ("m", "b")):
        unpack(sensor_messages.pack_odometry(one, frame_id=world, child_frame_id=child)[0])
    with pytest.raises(SampleError, match="the child frame `base_link_frd` says z down"):
        unpack(sensor_messages.pack_odometry(one, frame_id="odom", child_frame_id="base_link_frd")[0])
    with pytest.raises(SampleError, match="the frame `odom_ned` says north-east-down"):
        unpack(sensor_messages.pack_odometry(one, frame_id="odom_ned")[0])


def test_transforms_that_are_none_are_one_line() -> None:
    known = StaticTransforms()
    with pytest.raises(LogError, match=r"from base_link to imu_link is none \(quaternion of norm 0\)"):
        known.take(transforms(("base_link", "imu_link", (0.0, 0.0, 0.0, 0.0), PLACE)))
    links = ("base_link", "camera", (0.0, 0.0, 0.0, 0.0), PLACE), ("base_link", "gps", BACKWARD, PLACE)
    with pytest.raises(LogError, match="from base_link to camera is none"):
        known.take(transforms(*links))
    assert known.between("gps", "base_link") is not None
    whole = transforms(("base_link", "imu_link", BACKWARD, PLACE))
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            damaged[place] = rng.integers(256)
        try:
            known.take(bytes(damaged[: rng.integers(1, len(whole) + 1)]))
        except LogError:
            continue
    assert known.between("imu_link", "nowhere") is None


# An IMU away from the body's origin feels what a rigid body says; moved back, it is one at the origin.


RATE_HZ = 500.0
ARM = np.array([0.05, -0.03, 0.08])
TURN = rotation_matrix(np.array([0.8, 0.2, -0.4, 0.4]) / np.linalg.norm([0.8, 0.2, -0.4, 0.4]))


def swinging(seconds: float) -> tuple[np.ndarray, ...]:
    """Stamps, rates and specific force at the origin, and what an IMU measures, turned and away from it."""
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    pulse = 2.0 * np.pi * np.array([3.0, 2.0, 1.0])
    amplitude = np.array([4.0, 3.0, 2.0])
    rates = amplitude * np.sin(np.outer(time_s, pulse))
    angular = amplitude * pulse * np.cos(np.outer(time_s, pulse))
    force = np.array([0.3, -0.2, -9.81]) + 0.0 * rates
    there = force + np.cross(angular, ARM) + np.cross(rates, np.cross(rates, ARM))
    return np.rint(1e9 * time_s).astype(np.int64), rates, force, rates @ TURN, there @ TURN


def test_turned_and_moved_back() -> None:
    time_ns, rates, force, turned, felt = swinging(3.0)
    assert np.abs(felt @ TURN.T - force).max() > 5.0
    Mounting(TURN, ARM).move(time_ns, turned, felt)
    np.testing.assert_allclose(turned, rates, atol=1e-12)
    # What the angular acceleration changes in the lag and half a step, at most its own derivative times that.
    jerk = np.linalg.norm((2.0 * np.pi * np.array([3.0, 2.0, 1.0])) ** 2 * np.array([4.0, 3.0, 2.0]))
    bound = (LAG_S + 0.5 / RATE_HZ) * jerk * np.linalg.norm(ARM)
    assert np.abs(felt - force)[20:].max() < bound
    assert bound < 0.4


def test_without_an_arm_it_is_a_turn_alone() -> None:
    time_ns, rates, _, turned, felt = swinging(0.5)
    there = felt @ TURN.T
    Mounting(TURN, np.zeros(3)).move(time_ns, turned, felt)
    np.testing.assert_allclose(felt, there, atol=1e-12)
    np.testing.assert_allclose(turned, rates, atol=1e-12)


@pytest.mark.parametrize("block", [1, 7])
def test_blocks_of_any_length_give_the_same_bits(block: int) -> None:
    time_ns, _, _, rates, force = swinging(0.4)
    time_ns[100:] += 200_000_000
    rates[50] = np.nan
    whole_rates, whole_force = rates.copy(), force.copy()
    Mounting(TURN, ARM).move(time_ns, whole_rates, whole_force)
    mounting = Mounting(TURN, ARM)
    for start in range(0, len(time_ns), block):
        part = slice(start, start + block)
        mounting.move(time_ns[part], rates[part], force[part])
    np.testing.assert_array_equal(rates, whole_rates)
    np.testing.assert_array_equal(force, whole_force)
    # One sample without numbers spoils no other.
    assert np.flatnonzero(~np.isfinite(force).all(axis=1)).tolist() == [50]


def test_stamps_that_nearly_coincide_give_no_acceleration() -> None:
    time_ns, _, force, turned, felt = swinging(1.0)
    time_ns[100] = time_ns[99] + 1
    Mounting(TURN, ARM).move(time_ns, turned, felt)
    assert np.abs(felt - force).max() < 20.0


def test_rates_that_cannot_be_spoil_no_other_sample() -> None:
    time_ns, _, force, turned, felt = swinging(1.0)
    turned[100] = 1e20
    Mounting(TURN, ARM).move(time_ns, turned, felt)
    error = np.abs(felt - force).max(axis=1)
    assert np.flatnonzero(error[20:] > 1.0).tolist() == [80]
