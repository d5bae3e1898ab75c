# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.messages.payloads import Payloads

from .test_adapter_registry import opened
from .vendor_messages import START_NS, px4_imu, px4_odometry


@pytest.mark.parametrize("pose_frame", [1, 2])
def test_px4_odometry_is_stamped_when_sampled_with_its_velocity_in_the_body(vendor, pose_frame):
    """Yawed by 90° to the right, north is on the left."""
    vendor = vendor.px4_1_14
    unpacker = opened(vendor, "px4_odometry")
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
    unpacker = opened(vendor, "px4_odometry")
    unknown = px4_odometry(vendor, **{field: [np.nan] * (4 if field == "q" else 3)})
    stream = unpacker.unpack(Payloads.join([unknown, px4_odometry(vendor)]))
    assert len(stream) == 1
    assert sum(unpacker.dropped.values()) == 1


@pytest.mark.parametrize("frames", [(0, 1), (1, 0), (1, 2), (2, 1), (3, 3)])
def test_px4_odometry_in_frames_that_do_not_fit_is_refused(vendor, frames):
    vendor = vendor.px4_1_14
    wrong = px4_odometry(vendor, pose_frame=frames[0], velocity_frame=frames[1])
    with pytest.raises(LogError, match=f"sample 1: pose_frame {frames[0]}, velocity_frame {frames[1]}"):
        opened(vendor, "px4_odometry").unpack(Payloads.join([px4_odometry(vendor), wrong]))


def test_stamps_that_no_message_can_hold_are_refused(vendor):
    vendor = vendor.px4_1_14
    beyond = px4_odometry(vendor, timestamp_sample=2**31 * 10**6)
    with pytest.raises(LogError, match="sample 0: the stamp has 2147483648000000 µs"):
        opened(vendor, "px4_odometry").unpack(beyond)


def test_px4_imu_needs_no_conversion(vendor):
    vendor = vendor.px4_1_14
    stream = opened(vendor, "px4_imu").unpack(px4_imu(vendor))
    assert stream.time_ns.tolist() == [START_NS]
    np.testing.assert_allclose(stream.angular_velocity, [[0.1, 0.2, 0.3]], rtol=1e-6)
    np.testing.assert_allclose(stream.specific_force, [[1, 2, -9.8]], rtol=1e-6)
