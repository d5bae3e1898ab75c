# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The known messages of other packages: where each is published, and a package that adds one."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import (
    AirStream,
    BatteryStream,
    ImuStream,
    MotorCommandStream,
    OdometryStream,
    PoseStream,
    RotorSpeedStream,
    TemperatureStream,
)
from quadpi_core.messages.adapters import AdapterSettings, known_adapters
from quadpi_core.messages.adapters.adapter_settings import (
    BodySettings,
    CommandSettings,
    RotorSettings,
    StateSettings,
)
from quadpi_core.messages.frame_ids import TF_TYPE
from quadpi_core.paths import config_directory
from quadpi_core.vehicle import Vehicle

from .vendor_messages import EXAMPLES, SETTINGS, START_NS, Messages

# Where the packages publish by default, by their documentation and launch files.
PUBLISHED = {
    "mavros/esc_status/status": ("mavros_msgs/msg/ESCStatus", RotorSpeedStream),
    "mavros/esc_telemetry/telemetry": ("mavros_msgs/msg/ESCTelemetry", RotorSpeedStream),
    "fmu/out/esc_status": ("px4_msgs/msg/EscStatus", RotorSpeedStream),
    "fmu/out/vehicle_odometry": ("px4_msgs/msg/VehicleOdometry", OdometryStream),
    "fmu/out/sensor_combined": ("px4_msgs/msg/SensorCombined", ImuStream),
    "fmu/out/actuator_motors": ("px4_msgs/msg/ActuatorMotors", MotorCommandStream),
    "fmu/out/actuator_outputs": ("px4_msgs/msg/ActuatorOutputs", MotorCommandStream),
    "fmu/out/battery_status": ("px4_msgs/msg/BatteryStatus", BatteryStream),
    "mavros/rc/out": ("mavros_msgs/msg/RCOut", MotorCommandStream),
    "motors": ("crazyflie_interfaces/msg/LogDataGeneric", MotorCommandStream),
    "status": ("crazyflie_interfaces/msg/Status", BatteryStream),
    "battery": ("sensor_msgs/msg/BatteryState", BatteryStream),
    "motor_commands": ("quadpi/msg/MotorCommands", MotorCommandStream),
    "pressure": ("sensor_msgs/msg/FluidPressure", AirStream),
    "temperature": ("sensor_msgs/msg/Temperature", TemperatureStream),
    "fmu/out/vehicle_air_data": ("px4_msgs/msg/VehicleAirData", AirStream),
    "fix": ("sensor_msgs/msg/NavSatFix", OdometryStream),
    "rigid_bodies": ("mocap4r2_msgs/msg/RigidBodies", PoseStream),
    "poses": ("motion_capture_tracking_interfaces/msg/NamedPoseArray", PoseStream),
    "/tf": (TF_TYPE, PoseStream),
}


def opened(vendor, name, definition=None):
    adapter = known_adapters()[name]
    return adapter.open(definition or vendor.definition(adapter.type_name), SETTINGS, None)


@pytest.mark.parametrize("name", known_adapters())
def test_each_gives_its_stream_from_the_topic_of_its_package(vendor, name):
    adapter = known_adapters()[name]
    type_name, kind = PUBLISHED[adapter.topic]
    assert adapter.type_name == type_name
    stream = opened(vendor.px4_1_14, name).unpack(EXAMPLES[name](vendor.px4_1_14))
    assert (type(stream), len(stream)) == (kind, 1)
    assert stream.time_ns[0] // 10**9 == START_NS // 10**9


GUIDE = (Path(__file__).parents[4] / "docs" / "adapters.md").read_text()
GUIDE_EXAMPLE = re.search(r"```py\n(.*?)```", GUIDE, flags=re.DOTALL)[1]
ENTRY = re.search(r"# pyproject.toml\n\[project\.entry-points\.(.*?)```", GUIDE, flags=re.DOTALL)[1]
DEFINITION = "std_msgs/Header header\nfloat64[4] rpm\n"


@pytest.fixture
def package(tmp_path, monkeypatch, package_of_ones_own) -> Iterator[Path]:  # noqa: ARG001
    """The file of the guide's adapter in an installed package."""
    information = tmp_path / "my_package-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(f"[{ENTRY}".replace('"', ""))
    (tmp_path / "my_package").mkdir()
    (tmp_path / "my_package" / "__init__.py").touch()
    file = tmp_path / "my_package" / "rotor_rpm.py"
    file.write_text(GUIDE_EXAMPLE)
    monkeypatch.syspath_prepend(tmp_path)
    known_adapters.cache_clear()
    yield file
    known_adapters.cache_clear()


@pytest.mark.usefixtures("package")
def test_a_package_of_ones_own_adds_a_message():
    messages = Messages({"my_msgs/msg/RotorRpm": DEFINITION})
    payload = messages.bytes(
        messages.make(
            "my_msgs/msg/RotorRpm",
            header=messages.header(START_NS),
            rpm=np.array([60.0, 120.0, 180.0, 240.0]),
        )
    )
    assert list(known_adapters())[-1] == "rotor_rpm"
    stream = opened(messages, "rotor_rpm").unpack(payload)
    assert stream.time_ns.tolist() == [START_NS]
    np.testing.assert_allclose(stream.speeds, 2.0 * np.pi * np.array([[3.0, 1.0, 4.0, 2.0]]))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("1 / 0", r"^message `rotor_rpm` of my_package 1.0 .*rotor_rpm.py, line 1: ZeroDivisionError"),
        (
            GUIDE_EXAMPLE.replace('"rotor_rpm",', '"px4_imu",'),
            "^message `px4_imu` is declared twice: .*my_package 1.0",
        ),
    ],
)
def test_one_that_cannot_be_used_names_its_package(package, content, message):
    package.write_text(content)
    with pytest.raises(LogError, match=message):
        known_adapters()


def load(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return AdapterSettings.load(path)


@pytest.mark.parametrize(
    "path", sorted((config_directory() / "adapters").glob("*.yaml")), ids=lambda p: p.stem
)
def test_bundled_settings_load_by_name(path):
    assert AdapterSettings.load(path.stem) == AdapterSettings.load(path) != AdapterSettings()


def test_every_key(tmp_path):
    text = """
rotor_speeds: {rotors: [4, 1, 2, 3], unit: erpm, topic: /fmu/out/esc_status}
mocap: {body: 17, frames: fur-eus}
odometry: {topic: /odometry}
"""
    assert load(tmp_path, text) == AdapterSettings(
        rotor_speeds=RotorSettings((4, 1, 2, 3), "erpm", "/fmu/out/esc_status"),
        mocap=BodySettings("17", "fur-eus"),
        odometry=StateSettings("/odometry"),
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", r"expected keys and values, found \[\]"),
        (
            "rotors: {}",
            "unknown key `rotors`; known: rotor_speeds, mocap, odometry, imu, motor_commands, battery, "
            "pressure, temperature, topics, namespace; did you",
        ),
        ("rotor_speeds: 4", "rotor_speeds: expected keys and values, found 4"),
        ("rotor_speeds: {rotors: quad-x}", "rotor_speeds: missing key `unit`"),
        ("rotor_speeds: {rotors: quad-x, unit: rad/s}", "`unit` must be one of rpm, erpm, found 'rad/s'"),
        ("rotor_speeds: {rotors: quad-y, unit: rpm}", "`rotors` must list numbers .* or be quad-x or"),
        ("rotor_speeds: {rotors: {quad-x: 1}, unit: rpm}", "`rotors` must list numbers .* or be quad-x or"),
        (
            "rotor_speeds: {rotors: [1, 2, 2], unit: rpm}",
            "rotor_speeds: `rotors` must be different numbers",
        ),
        ("rotor_speeds: {rotors: [0, 1, 2, 3], unit: rpm}", "different numbers"),
        ("rotor_speeds: {rotors: [1, 1, 2, 3], unit: rpm}", "different numbers"),
        ("rotor_speeds: {rotors: quad-x, unit: rpm, topic: 4}", "`topic` must be text, found 4"),
        ("mocap: {frames: flu-enu}", "mocap: missing key `body`"),
        ("mocap: {body: '', frames: flu-enu}", "`body` must be the name of a body"),
        (
            "mocap: {body: quad, frames: enu}",
            "`frames` must be one of flu-enu, frd-ned, fur-eus, found 'enu'",
        ),
        ("imu: {rate: 3}", "imu: unknown key `rate`; known: topic"),
        ("imu:", "imu: expected keys and values, such as {}, found nothing"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_key(tmp_path, text, message):
    with pytest.raises(LogError, match=rf"{re.escape(str(tmp_path))}/mine\.yaml: .*{message}"):
        load(tmp_path, text)


def test_an_order_is_of_as_many_rotors_as_the_vehicle_has():
    for settings in (RotorSettings(rotors=(1, 2, 3), unit="rpm"), CommandSettings(rotors=(1, 2, 3))):
        assert settings.order(None).controllers == (0, 1, 2)
        with pytest.raises(LogError, match="rotor order of 3 numbers; vehicle neurobem has 4 rotors"):
            settings.order(Vehicle.load("neurobem"))


def test_an_unknown_name_lists_those_there_are():
    with pytest.raises(LogError, match=r"no such adapter file; known adapters: .*mavros.*px4"):
        AdapterSettings.load("pixhawk")
