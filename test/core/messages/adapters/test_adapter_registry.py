# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The known messages of other packages: where each is published, and which versions of it are taken."""

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, OdometryStream, PoseStream, RotorSpeedStream
from quadpi_core.messages.adapters import ADAPTERS, AdapterSettings
from quadpi_core.messages.adapters.adapter_settings import BodySettings, RotorSettings, StateSettings

from .vendor_messages import START_NS, frame, mavros_status, mavros_telemetry, px4_odometry, px4_status

STATUS, PX4 = "mavros_status", "px4_status"
SETTINGS = AdapterSettings(
    rotor_speeds=RotorSettings((3, 1, 4, 2), "rpm"),
    mocap=BodySettings("quad", "flu-enu"),
    odometry=StateSettings(),
    imu=StateSettings(),
)
# Where the packages publish by default, by their documentation and launch files.
PUBLISHED = {
    "mavros/esc_status/status": ("mavros_msgs/msg/ESCStatus", RotorSpeedStream),
    "mavros/esc_telemetry/telemetry": ("mavros_msgs/msg/ESCTelemetry", RotorSpeedStream),
    "fmu/out/esc_status": ("px4_msgs/msg/EscStatus", RotorSpeedStream),
    "fmu/out/vehicle_odometry": ("px4_msgs/msg/VehicleOdometry", OdometryStream),
    "fmu/out/sensor_combined": ("px4_msgs/msg/SensorCombined", ImuStream),
    "rigid_bodies": ("mocap4r2_msgs/msg/RigidBodies", PoseStream),
    "poses": ("motion_capture_tracking_interfaces/msg/NamedPoseArray", PoseStream),
}


def opened(vendor, name, definition=None):
    adapter = ADAPTERS[name]
    return adapter.open(definition or vendor.definition(adapter.type_name), SETTINGS, None)


def example(vendor, type_name):
    quad = [("quad", (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))]
    made = {
        "mavros_msgs/msg/ESCStatus": lambda: mavros_status(vendor, START_NS, [1, 2, 3, 4]),
        "mavros_msgs/msg/ESCTelemetry": lambda: mavros_telemetry(vendor, START_NS, [1, 2, 3, 4], [1] * 4),
        "px4_msgs/msg/EscStatus": lambda: px4_status(vendor, START_NS, [1, 2, 3, 4]),
        "px4_msgs/msg/VehicleOdometry": lambda: px4_odometry(vendor),
        "px4_msgs/msg/SensorCombined": lambda: px4_imu(vendor),
        "mocap4r2_msgs/msg/RigidBodies": lambda: frame(vendor, "mocap4r2", START_NS, quad),
    }
    return made.get(type_name, lambda: frame(vendor, "named_poses", START_NS, quad))()


def px4_imu(vendor):
    still = dict.fromkeys(("gyro_rad", "accelerometer_m_s2"), np.zeros(3, np.float32))
    return vendor.bytes(vendor.make("px4_msgs/msg/SensorCombined", timestamp=START_NS // 1000, **still))


@pytest.mark.parametrize("name", ADAPTERS)
def test_each_gives_its_stream_from_the_topic_of_its_package(vendor, name):
    adapter = ADAPTERS[name]
    type_name, kind = PUBLISHED[adapter.topic]
    assert adapter.type_name == type_name
    stream = opened(vendor.px4_1_14, name).unpack(example(vendor.px4_1_14, type_name))
    assert (type(stream), stream.time_ns.tolist()) == (kind, [START_NS])


def test_settings_of_the_kind_are_needed(vendor):
    adapter = ADAPTERS[STATUS]
    with pytest.raises(LogError, match="needs settings for `rotor_speeds`"):
        adapter.open(vendor.px4_1_14.definition(adapter.type_name), AdapterSettings(), None)


def test_definition_of_another_version_does_not_decode_silently(vendor):
    payload = px4_status(vendor.px4_1_18, START_NS, [1000, 2000, 3000, 4000])
    with pytest.raises(LogError, match=r"sample 0: .* px4_msgs/msg/EscStatus"):
        opened(vendor.px4_1_14, PX4).unpack(payload)


@pytest.mark.parametrize("name", ADAPTERS)
def test_a_version_without_a_field_that_is_read_is_refused(vendor, name):
    """The last field that an adapter reads has another name in it."""
    adapter = ADAPTERS[name]
    field = list(adapter.columns)[-1].rpartition(".")[2]
    renamed = vendor.px4_1_14.definition(adapter.type_name).replace(f" {field}\n", f" {field}_2\n")
    with pytest.raises(LogError, match=rf"this version of {adapter.type_name} has no field \S*{field} of"):
        opened(vendor.px4_1_14, name, renamed)
