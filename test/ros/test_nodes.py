# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters and the errors of the programs, as a user meets them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from rclpy.lifecycle import TransitionCallbackReturn

from quadpi_core.errors import ModelError
from quadpi_core.monitor import MonitorSettings
from quadpi_core.results import ReportedAlarms
from quadpi_ros.collector import AlarmFollower
from quadpi_ros.node_parameters import EstimatorParameters, MonitorParameters, parameter
from quadpi_ros.runtime import start

pytestmark = pytest.mark.usefixtures("ros_domain")

ROOT = Path(__file__).parents[2]
NODES = {"estimator": EstimatorParameters, "monitor": MonitorParameters}
# Set by the launch file from its arguments.
FROM_LAUNCH = {"vehicle", "model"}
IN_FLIGHT = {"persistence_s", "release_s", "alarm_rate_hz"}


Main = Callable[..., tuple[int, str]]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["vehicle:=neurobem", "vehikel:=x"],
            "node estimator: unknown parameter `vehikel`; known: adapters, autostart, body_frame",
        ),
        ([], "node estimator: parameter `vehicle` is required"),
        (
            ["vehicle:=neurobem", "imu_rate_hz:=fast"],
            "parameter `imu_rate_hz` must be a double, found 'fast'",
        ),
        (
            ["vehicle:=neurobem", "imu_rate_hz:=9000"],
            "parameter `imu_rate_hz` must lie between 0 and 5000, found 9000",
        ),
        (["vehicle:=neurobem", "imu_rate_hz:=.nan"], "parameter `imu_rate_hz` must lie between"),
        (["vehicle:=no_such"], "no such vehicle file; known vehicles:"),
    ],
)
def test_estimator_refuses_wrong_parameters(run_main: Main, overrides: list[str], message: str) -> None:
    arguments = [part for override in overrides for part in ("-p", override)]
    status, errors = run_main("estimator_node", "--ros-args", *arguments)
    assert status == 2
    (line,) = errors.splitlines()
    assert line.startswith("quadpi: ")
    assert message in line


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["vehicle:=neurobem", "model:=m", "rotor_topic:=rpm"],
            "must be one of rotor_speeds, erpm, mavros_status, mavros_telemetry, px4_status, found `rpm`",
        ),
        (["vehicle:=neurobem", "model:=m", "rotor_topic:=erpm"], "electrical rotor speeds need `pole_pairs`"),
        (
            ["vehicle:=neurobem", "model:=m", "world_frame:=map", "monitor:mode:=x"],
            "unknown parameter `mode`",
        ),
        (
            ["vehicle:=neurobem", "model:=m", "rotor_topic:=px4_status"],
            "node monitor: parameter `adapters` is required for `px4_status`",
        ),
        (
            ["vehicle:=neurobem", "model:=m", "mocap_topic:=mocap4r2", "adapters:=px4"],
            "px4_msgs/msg/SensorCombined: the package px4_msgs that defines it is not installed here",
        ),
        (
            ["vehicle:=neurobem", "model:=m", "rotor_topic:=mavros_status", "adapters:=mavros"],
            "mavros_msgs/msg/ESCStatus: the package mavros_msgs that defines it is not installed here",
        ),
        (["vehicle:=neurobem", "model:=m", "adapters:=no_such"], "no such adapter file"),
    ],
)
def test_live_process_refuses_wrong_parameters(run_main: Main, overrides: list[str], message: str) -> None:
    arguments = [part for override in overrides for part in ("-p", override)]
    status, errors = run_main("live_process", "--ros-args", *arguments)
    assert status == 2
    (line,) = errors.splitlines()
    assert message in line


def test_wrong_ros_argument_is_one_line() -> None:
    process = subprocess.run(
        [sys.executable, "-m", "quadpi_ros.live_process", "--ros-args", "--nonsense"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert process.returncode == 2
    assert process.stderr.splitlines()[-1] == "quadpi: unknown ROS arguments ['--nonsense']"


def test_player_names_a_bag_that_is_not_there(run_main: Main, tmp_path: Path) -> None:
    status, errors = run_main("player", str(tmp_path / "none.mcap"))
    assert status == 2
    assert errors == f"quadpi: {tmp_path / 'none.mcap'}: no such bag\n"


@pytest.mark.usefixtures("ros")
def test_an_integer_is_taken_for_a_double_and_all_is_described() -> None:
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    from quadpi_ros.parameters import read_parameters

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


def test_alarm_follower_tells_changes_from_repetition() -> None:
    def alarm(time_s: float, level: int, *inputs: str) -> Any:
        return SimpleNamespace(
            time_ns=[round(time_s * 1e9)],
            level=[level],
            causes=[1 if level else 0],
            inputs_outside=[inputs],
            envelope_distance=[0.1],
        )

    follower = AlarmFollower(start_ns=0)
    rows: list[ReportedAlarms] = [
        alarm(0.0, 0),
        alarm(0.1, 1, "u"),
        alarm(0.2, 2, "u"),
        alarm(0.3, 2, "u"),
        alarm(0.4, 2, "p", "u"),
        alarm(0.5, 2, "p"),
        alarm(0.6, 0),
        alarm(0.7, 0, "u"),
    ]
    changes = [follower.follow(row) for row in rows]
    assert [change is not None for change in changes] == [False, True, True, False, True, False, True, False]
    assert changes[4].time_s == pytest.approx(0.4)
    assert changes[4].inputs_outside == ("p", "u")


@dataclass(frozen=True)
class NoParameters:
    autostart: bool = parameter(False, "as the nodes have it")


@pytest.mark.usefixtures("ros")
def test_the_log_says_once_what_keeps_a_node_from_working(monkeypatch: pytest.MonkeyPatch) -> None:
    from geometry_msgs.msg import PoseStamped
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import Imu

    from quadpi_core.messages import sensor_messages
    from quadpi_ros.sensor_node import SensorNode

    class Watched(SensorNode[NoParameters]):
        def activate(self) -> None:
            self.listen(Imu, "imu", sensor_messages.unpack_imu, lambda _: None)
            self.listen(PoseStamped, "mocap/pose", sensor_messages.unpack_pose, lambda _: None)
            self.listen(PoseStamped, "wind", sensor_messages.unpack_pose, lambda _: None, required=False)

    node, receivers = Watched("watched", NoParameters), {}
    create = node.create_subscription

    def create_and_keep(kind: type, topic: str, receive: Any, *rest: Any, **options: Any) -> Any:
        receivers[topic] = receive
        return create(kind, topic, receive, *rest, **options)

    monkeypatch.setattr(node, "create_subscription", create_and_keep)
    start([node])
    (diagnose,) = node.timers
    assert node.state == "unconfigured"
    node.must(node.trigger_configure)
    node.must(node.trigger_activate)
    logged: list[str] = []
    monkeypatch.setattr(node, "get_logger", lambda: SimpleNamespace(warning=logged.append))

    pose = PoseStamped()
    pose.pose.orientation.w = 1.0
    sent = {"imu": serialize_message(Imu()), "mocap/pose": serialize_message(pose)}

    def watch(*topics: str) -> list[str]:
        logged.clear()
        for topic in topics:
            receivers[topic](sent[topic])
        diagnose.callback()
        return list(logged)

    assert watch() == []
    assert watch() == ["nothing arrives on imu, mocap/pose"]
    assert watch() == []
    assert watch("imu") == []
    assert watch("imu") == ["nothing arrives on mocap/pose"]
    assert watch("imu", "mocap/pose") == []
    assert watch("imu", "mocap/pose") == []
    node.warn("topic imu", "one")
    node.warn("topic imu", "two")
    node.warn("topic mocap/pose", "three")
    assert logged == ["topic imu: one", "topic mocap/pose: three"]
    sent["imu"] = sent["imu"][:20]
    assert watch("imu", "mocap/pose") == []
    assert watch("imu", "mocap/pose") == ["every message is refused on imu"]
    assert (node.lack("imu"), node.lack("mocap/pose")) == ("every message is refused on imu", None)
    assert watch("imu") == []
    assert watch("imu") == ["nothing arrives on mocap/pose; every message is refused on imu"]
    node.must(node.trigger_deactivate)
    assert watch() == []
    assert watch() == []
    node.destroy_node()


@pytest.mark.usefixtures("ros")
def test_a_failed_configuration_is_one_line_and_can_be_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    from quadpi_ros.sensor_node import SensorNode

    errors: list[Exception] = [ModelError("m: no such model"), ValueError("a bug")]
    undone: list[str] = []

    class Failing(SensorNode[NoParameters]):
        def configure(self) -> None:
            if errors:
                raise errors.pop(0)

        def cleanup(self) -> None:
            undone.append("cleanup")
            super().cleanup()

    node = Failing("failing", NoParameters)
    logged: list[str] = []
    monkeypatch.setattr(node, "get_logger", lambda: SimpleNamespace(error=logged.append))
    assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
    assert logged == ["m: no such model"]
    assert undone == ["cleanup"]
    assert node.trigger_configure() == TransitionCallbackReturn.ERROR
    assert "ValueError: a bug" in logged[-1]
    assert node.state == "unconfigured"
    errors.append(ValueError("another bug"))
    with pytest.raises(ValueError, match="another bug"):
        node.must(node.trigger_configure)
    node.must(node.trigger_configure)
    assert node.state == "inactive"
    assert node.trigger_shutdown() == TransitionCallbackReturn.SUCCESS
    assert node.state == "finalized"
    node.destroy_node()


@pytest.mark.parametrize(
    ("remapping", "prediction"),
    [("prediction:=/lab/wrench", "/lab/wrench"), ("imu:=/lab/imu", "/uav/prediction")],
)
def test_predictions_of_all_models_go_by_the_other_name(
    remapping: str, prediction: str, ros_domain: int, folder: Path
) -> None:
    import rclpy

    from quadpi_ros.monitor_node import MonitorNode

    model = f"model:=[{folder / 'model'}, {folder / 'other'}]"
    given = ["-p", "vehicle:=neurobem", "-p", model, "-r", "__ns:=/uav", "-r", remapping]
    rclpy.init(args=["--ros-args", *given], domain_id=ros_domain)
    try:
        node = MonitorNode()
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        topics = {publisher.topic_name for publisher in node.publishers}
        assert topics >= {prediction, f"{prediction}/other"}
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
