# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Processes and managed nodes that cannot start, or fail while they run."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from std_msgs.msg import String

from quadpi_core.errors import ModelError
from quadpi_ros import runtime
from quadpi_ros.callbacks import GuardedNode
from quadpi_ros.live_session import ChildError, isolated_domain
from quadpi_ros.parameters import parameter
from quadpi_ros.sensor_node import SensorNode

pytestmark = pytest.mark.usefixtures("ros_domain")


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


@dataclass(frozen=True)
class NoParameters:
    autostart: bool = parameter(False, "as the nodes have it")


@dataclass(frozen=True)
class Starting:
    autostart: bool = parameter(True, "as the nodes have it")


@pytest.mark.usefixtures("ros")
def test_a_failed_configuration_is_one_line_and_can_be_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
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


@pytest.mark.usefixtures("ros")
def test_an_exception_of_the_executor_itself_ends_no_node(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """As of a request whose bytes rclpy cannot take apart."""
    node = GuardedNode("spinning")
    executor = EventsExecutor()
    spins: list[float] = []

    class Failing:
        def add_node(self, _: Any) -> None:
            executor.add_node(node)

        def spin_until_future_complete(self, future: Any, timeout_sec: float) -> None:
            spins.append(timeout_sec)
            if len(spins) < 4:
                raise RuntimeError("cannot take the request")
            executor.spin_until_future_complete(future, timeout_sec=0.0)
            rclpy.try_shutdown()

    monkeypatch.setattr(runtime, "EventsExecutor", Failing)
    runtime.spin([node])
    assert len(spins) == 4
    assert node.exceptions.counts == {"executor": 3}
    assert capfd.readouterr().err.count("RuntimeError: cannot take the request") == 2
    executor.remove_node(node)


@pytest.mark.usefixtures("ros")
def test_all_nodes_are_configured_before_one_is_active() -> None:
    """A node that takes seconds to configure would be behind the samples of another one."""
    made: list[str] = []

    class Node(runtime.ManagedNode[Any]):
        def configure(self) -> None:
            made.append(f"{self.get_name()} configured")

        def activate(self) -> None:
            made.append(f"{self.get_name()} active")

    nodes = [Node("one", Starting), Node("asleep", NoParameters), Node("two", Starting)]
    runtime.start(nodes)
    assert made == ["one configured", "two configured", "one active", "two active"]
    assert [node.state for node in nodes] == ["active", "unconfigured", "active"]
    for node in nodes:
        node.destroy_node()


@pytest.mark.usefixtures("ros")
def test_what_a_failed_start_has_made_is_undone() -> None:
    undone: list[str] = []

    class Failing(runtime.ManagedNode[Any]):
        def activate(self) -> None:
            raise ModelError("m: gone")

        def deactivate(self) -> None:
            undone.append("deactivated")

    node = Failing("failing", Starting)
    with pytest.raises(ModelError, match="m: gone"):
        runtime.start([node])
    assert undone == ["deactivated"]
    assert node.state == "inactive"
    node.destroy_node()


@pytest.mark.parametrize(
    ("raised", "status", "said"),
    [
        (None, 0, ""),
        (KeyboardInterrupt(), 0, ""),
        (ExternalShutdownException(), 0, ""),
        (ModelError("m: no such model"), 2, "quadpi: m: no such model\n"),
    ],
)
def test_the_exit_status_tells_what_a_user_can_correct(
    raised: BaseException | None,
    status: int,
    said: str,
    ros_domain: int,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    del ros_domain
    monkeypatch.setattr(sys, "argv", ["program"])

    def work() -> None:
        assert rclpy.ok()
        if raised is not None:
            raise raised

    assert runtime.run(work) == status
    assert capfd.readouterr().err == said
    assert not rclpy.ok()


@pytest.mark.parametrize("ended", [True, False])
def test_a_message_in_the_moment_of_a_signal_is_no_error(
    ended: bool, ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    del ros_domain
    monkeypatch.setattr(sys, "argv", ["program"])

    def work() -> None:
        node = rclpy.create_node("talks")
        publisher = node.create_publisher(String, "said", 1)
        if ended:
            rclpy.shutdown()
            publisher.publish(String(data="too late"))
        raise RCLError("not by a signal")

    if ended:
        assert runtime.run(work) == 0
    else:
        with pytest.raises(RCLError, match="not by a signal"):
            runtime.run(work)


BUSY = """
import time
from quadpi_ros.callbacks import GuardedNode
from quadpi_ros.runtime import run, spin
def work():
    node = GuardedNode("busy")
    node.create_timer(0.001, lambda: time.sleep(0.002))
    node.create_timer(0.5, lambda: print("spins", flush=True))
    spin([node])
raise SystemExit(run(work))
"""


def test_a_signal_in_the_middle_of_a_callback_ends_without_a_word() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", BUSY], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "spins\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")


# A ROS domain for child processes, which no other session on this machine has at the same time.


def test_a_domain_is_of_one_session_alone(ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    every = range(1, 101)
    monkeypatch.setattr(random, "sample", lambda *_: [ros_domain, *every])
    with isolated_domain():
        assert int(os.environ["ROS_DOMAIN_ID"]) in {*every} - {ros_domain}
    assert os.environ["ROS_DOMAIN_ID"] == str(ros_domain)
    monkeypatch.setattr(random, "sample", lambda *_: [ros_domain])
    with pytest.raises(ChildError, match="every ROS domain"), isolated_domain():
        pass
