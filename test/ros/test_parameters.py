# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Parameter files as users write them: for all nodes at once, in namespaces, with rclpy's own parameters."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, ReliabilityPolicy
from sensor_msgs.msg import Imu

from quadpi_core.logs.mavlink_samples import SOURCES
from quadpi_core.monitor import MonitorSettings
from quadpi_ros.callbacks import SENSOR_QOS, GuardedNode, QosOverrideError
from quadpi_ros.estimator_node import EstimatorNode
from quadpi_ros.monitor_node import MonitorNode
from quadpi_ros.parameters import (
    MAVLINK_IMU_MESSAGES,
    BridgeParameters,
    EstimatorParameters,
    MonitorParameters,
    ParameterError,
    read_parameters,
)

from .rig import started

ROOT = Path(__file__).parents[2]
ASLEEP = ("-p", "autostart:=false", "-p", "vehicle:=neurobem")


def made(kind: Callable[[], Any]) -> Any:
    """The values of a node's parameters, and the names that its services list."""
    node = kind()
    names = node.list_parameters([], 0).names
    values = node.parameters
    node.destroy_node()
    return values, set(names)


def example(page: str, marker: str) -> str:
    """A YAML block of the documentation."""
    blocks = re.findall(r"^```yaml\n(.*?)^```", (ROOT / "docs" / page).read_text(), re.MULTILINE | re.DOTALL)
    (found,) = [block for block in blocks if marker in block]
    return found


def test_one_file_serves_every_process(ros_domain: int, tmp_path: Path) -> None:
    """The example of the documentation, with `separate:=true`."""
    file = tmp_path / "field-nodes.yaml"
    file.write_text(example("adapters.md", "field-nodes.yaml"))
    with started(ros_domain, "--params-file", str(file), *ASLEEP, "-p", "model:=some-model"):
        estimator, of_estimator = made(EstimatorNode)
        monitor, of_monitor = made(MonitorNode)
    assert estimator.mocap_topic == "mocap4r2"
    assert monitor.rotor_topic == "mavros_status"
    assert estimator.adapters == monitor.adapters == "field.yaml"
    # Nobody can set what a node does not have.
    assert "rotor_topic" not in of_estimator
    assert "mocap_topic" not in of_monitor


@pytest.mark.parametrize("kind", [EstimatorNode, MonitorNode])
def test_a_typing_error_in_a_file_for_every_process_is_refused(
    ros_domain: int, tmp_path: Path, kind: Callable[[], Any]
) -> None:
    file = tmp_path / "field-nodes.yaml"
    file.write_text(example("adapters.md", "field-nodes.yaml").replace("rotor_topic", "rotor_topics"))
    with (
        started(ros_domain, "--params-file", str(file), *ASLEEP, "-p", "model:=some-model"),
        pytest.raises(ParameterError, match="unknown parameter `rotor_topics`"),
    ):
        kind()


FILES = [
    ("estimator", "monitor.yaml", "imu_rate_hz", 400.0),
    ("monitor", "monitor.yaml", "release_s", 0.75),
    ("mavlink_bridge", "mavlink.yaml", "state_rate_hz", 50.0),
]


@pytest.mark.parametrize(("node", "file", "name", "value"), FILES)
@pytest.mark.parametrize("namespace", ["", "uav1", "field/uav2"])
def test_a_parameter_file_reaches_a_node_in_any_namespace(
    ros_domain: int, tmp_path: Path, node: str, file: str, name: str, value: float, namespace: str
) -> None:
    content = yaml.safe_load((ROOT / "config" / "nodes" / file).read_text())
    content[f"/**/{node}"]["ros__parameters"][name] = value
    path = tmp_path / file
    path.write_text(yaml.safe_dump(content))
    given = (
        ("-p", "connection:=udp:127.0.0.1:5999") if node == "mavlink_bridge" else ("-p", "model:=some-model")
    )
    start = ("--params-file", str(path), *ASLEEP, *given, "-r", f"__ns:=/{namespace}")
    with started(ros_domain, *start):
        if node == "mavlink_bridge":
            bridge = GuardedNode(node)
            values = read_parameters(bridge, BridgeParameters)
            bridge.destroy_node()
        else:
            values, _ = made({"estimator": EstimatorNode, "monitor": MonitorNode}[node])
    assert getattr(values, name) == value
    # Each vehicle has a body of its own; the world is one.
    assert values.body_frame == (f"{namespace}/base_link" if namespace else "base_link")
    if node != "monitor":
        assert values.world_frame == "map"


@pytest.mark.parametrize(
    ("given", "system"), [("7", 7), ("7.0", 7), ("0.0", 0), ("7.5", None), ("256", None), ("-1", None)]
)
def test_the_system_is_an_integer(ros_domain: int, given: str, system: int | None) -> None:
    arguments = ("-p", "connection:=c", "-p", f"system:={given}", "-p", "vehicle:=neurobem")
    with started(ros_domain, *arguments):
        node = GuardedNode("mavlink_bridge")
        if system is None:
            with pytest.raises(ParameterError, match="parameter `system` must"):
                read_parameters(node, BridgeParameters)
            return
        assert read_parameters(node, BridgeParameters).system == system
        assert node.get_parameter("system").type_ == Parameter.Type.INTEGER
        (limits,) = node.describe_parameter("system").integer_range
        assert (limits.from_value, limits.to_value) == (0, 255)


OVERRIDES = """
/**:
  ros__parameters:
    use_sim_time: true
    start_type_description_service: false
    qos_overrides:
      /uav1/imu_raw:
        subscription: {reliability: reliable, depth: 7}
      /diagnostics:
        publisher: {history: keep_all}
      /another/node:
        publisher: {durability: transient_local}
"""


def test_standard_parameters_do_what_rclpy_says(ros_domain: int, tmp_path: Path) -> None:
    file = tmp_path / "standard.yaml"
    file.write_text(OVERRIDES)
    start = ("--params-file", str(file), *ASLEEP, "-r", "__ns:=/uav1", "-r", "imu:=imu_raw")
    with started(ros_domain, *start):
        node = EstimatorNode()
        assert node.get_clock().ros_time_is_active
        assert not any(one.srv_name.endswith("get_type_description") for one in node.services)
        subscription = node.create_subscription(Imu, "imu", print, SENSOR_QOS)
        assert subscription.qos_profile.reliability == ReliabilityPolicy.RELIABLE
        assert subscription.qos_profile.depth == 7
        (publisher,) = [one for one in node.publishers if one.topic_name == "/diagnostics"]
        assert publisher.qos_profile.history == HistoryPolicy.KEEP_ALL
        # A profile that nodes share stays what it is.
        assert SENSOR_QOS.reliability == ReliabilityPolicy.BEST_EFFORT
        (result,) = node.set_parameters(
            [Parameter("qos_overrides./uav1/imu_raw.subscription.depth", value=9)]
        )
        assert not result.successful
        assert "read-only" in result.reason
        node.destroy_node()


@pytest.mark.parametrize("name", ["use_sim_time", "start_type_description_service"])
def test_standard_parameters_of_a_wrong_type_are_refused(ros_domain: int, name: str) -> None:
    with (
        started(ros_domain, *ASLEEP, "-p", f"{name}:=maybe"),
        pytest.raises(ParameterError, match=f"parameter `{name}` must be a bool, found 'maybe'"),
    ):
        EstimatorNode()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("qos_overrides./imu.subscription.reliabilty", "reliable", "is none of"),
        ("qos_overrides./imu.subscriber.reliability", "reliable", "is none of"),
        ("qos_overrides.imu.subscription.reliability", "reliable", "is none of"),
        ("qos_overrides./imu.subscription.reliability", "very", "must be one of system_default, reliable"),
        ("qos_overrides./imu.subscription.depth", "deep", "must be a positive integer, found 'deep'"),
        ("qos_overrides./imu.subscription.depth", "0", "must be a positive integer, found 0"),
    ],
)
def test_wrong_overrides_are_refused(ros_domain: int, name: str, value: str, message: str) -> None:
    with (
        started(ros_domain, *ASLEEP, "-p", f"{name}:={value}"),
        pytest.raises(QosOverrideError, match=message),
    ):
        EstimatorNode()


IN_FLIGHT = {"persistence_s", "release_s", "alarm_rate_hz"}


@pytest.mark.usefixtures("ros")
def test_an_integer_is_taken_for_a_double_and_all_is_described() -> None:
    node = Node(
        "monitor",
        automatically_declare_parameters_from_overrides=True,
        parameter_overrides=[
            Parameter("vehicle", value="v"),
            Parameter("model", value="m"),
            Parameter("imu_rate_hz", value=400),
        ],
    )
    parameters = read_parameters(node, MonitorParameters)
    assert isinstance(parameters.imu_rate_hz, float)
    assert parameters.imu_rate_hz == 400.0
    assert parameters.model == ("m",)
    for item in fields(MonitorParameters):
        descriptor = node.describe_parameter(item.name)
        assert descriptor.description
        assert descriptor.read_only == (item.name not in IN_FLIGHT)
    (limits,) = node.describe_parameter("imu_rate_hz").floating_point_range
    assert (limits.from_value, limits.to_value) == (0.0, 5000.0)
    node.destroy_node()


# The parameters of all nodes agree with the files, the core and the readers that they describe.


ROOT = Path(__file__).parents[2]


NODES = {"estimator": EstimatorParameters, "monitor": MonitorParameters}


# Set by the launch file from its arguments.
FROM_LAUNCH = {"vehicle", "model"}


def test_parameter_file_and_nodes_agree() -> None:
    file = yaml.safe_load((ROOT / "config" / "nodes" / "monitor.yaml").read_text())
    assert file.keys() == {f"/**/{name}" for name in NODES}
    for name, parameters in NODES.items():
        defaults = {item.name: item.default for item in fields(parameters) if item.name not in FROM_LAUNCH}
        assert file[f"/**/{name}"]["ros__parameters"] == defaults


def test_alarm_defaults_are_those_of_the_core() -> None:
    settings = MonitorSettings()
    defaults = {item.name: item.default for item in fields(MonitorParameters)}
    for item in fields(MonitorSettings):
        assert defaults[item.name] == getattr(settings, item.name)


def test_the_bridge_takes_every_imu_message_that_it_can_read() -> None:
    assert SOURCES["imu"] == MAVLINK_IMU_MESSAGES
