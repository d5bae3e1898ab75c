# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Exceptions in callbacks: logged, counted in the diagnostics, and the end of nothing."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger

from quadpi_ros import callbacks, sensor_node
from quadpi_ros.callbacks import GuardedNode, SlowService
from quadpi_ros.estimator_node import EstimatorNode
from quadpi_ros.live_session import Child

from .failing_live import ESTIMATOR_FAILS_HZ, MONITOR_FAILS_HZ
from .rig import (
    STARTED_S,
    Rig,
    arguments,
    assert_alive,
    assert_whole,
    spinning,
    started,
    values_of,
    wait_until,
)


def fail(*_: Any) -> Any:
    raise ValueError("of the test")


@pytest.mark.usefixtures("ros")
def test_every_kind_of_callback_may_fail(capfd: pytest.CaptureFixture[str]) -> None:
    node = GuardedNode("failing")
    executor = EventsExecutor()
    executor.add_node(node)

    def until(condition: Any) -> None:
        wait_until(condition, spinning(executor), lambda: node.exceptions.counts)

    node.create_timer(0.01, fail, clock=Clock(clock_type=ClockType.STEADY_TIME))
    until(lambda: node.exceptions.counts["timer fail"] > 3)
    subscription = node.create_subscription(String, "words", fail, 10)
    publisher = node.create_publisher(String, "words", 10)
    until(subscription.get_publisher_count)
    for _ in range(5):
        publisher.publish(String(data="word"))
    until(lambda: node.exceptions.counts["topic /words"] == 5)
    for name, service in (
        ("plain", node.create_service(Trigger, "plain", fail)),
        ("slow", SlowService(node, Trigger, "slow", fail)),
        ("late", SlowService(node, Trigger, "late", lambda _: fail)),
    ):
        assert service
        client = node.create_client(Trigger, name)
        until(client.service_is_ready)
        answer = client.call_async(Trigger.Request())
        until(answer.done)
        assert not answer.result().success
    services = {name for name in node.exceptions.counts if name.startswith("service")}
    assert services == {"service plain", "service slow", "service late"}
    # An event: a publisher that the subscription cannot hear.
    events = SubscriptionEventCallbacks(incompatible_qos=fail)
    node.create_subscription(String, "reliable", fail, 10, event_callbacks=events)
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_publisher(String, "reliable", best_effort)
    until(lambda: any(name.startswith("event") for name in node.exceptions.counts))
    errors = capfd.readouterr().err
    # However often it failed: one traceback of the timer, then a line every few seconds.
    assert errors.count("exception in timer fail: ValueError: of the test") == 1
    assert errors.count("Traceback") == len(node.exceptions.counts)
    (status,) = node.exceptions.statuses()
    assert (status.name, status.level) == ("failing: callbacks", DiagnosticStatus.ERROR)
    assert "ValueError: of the test" in status.message
    assert int(values_of(status)["topic /words"]) == 5
    executor.remove_node(node)
    node.destroy_node()


def test_what_goes_on_is_said_every_five_seconds(ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exceptions of one kind and place, and warnings of one subject."""
    with started(ros_domain, "-p", "vehicle:=neurobem"):
        node = EstimatorNode()
        said: list[str] = []
        monkeypatch.setattr(
            node, "get_logger", lambda: SimpleNamespace(error=said.append, warning=said.append)
        )
        for seconds, spoken in ((100.0, 3), (104.9, 0), (105.1, 2)):
            for module in (callbacks, sensor_node):
                monkeypatch.setattr(
                    module, "time", SimpleNamespace(monotonic=lambda seconds=seconds: seconds)
                )
            said.clear()
            node.exceptions.take("topic imu", ValueError("of the test"))
            if seconds == 100.0:
                node.exceptions.take("topic imu", KeyError("of another kind"))
            node.warn("topic imu", "refused")
            assert len(said) == spoken, said
        assert said[0] == "exception in topic imu: ValueError: of the test (4 so far)"
        node.destroy_node()


@pytest.fixture(scope="module")
def live(ros_domain: int, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Child]:
    del ros_domain
    errors = tmp_path_factory.mktemp("err")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join((str(Path(__file__).parent), *sys.path)))
        with Child("failing_live", arguments(str(folder / "model")), errors) as nodes:
            yield nodes


def test_a_node_that_fails_leaves_the_other_alone(running: Rig) -> None:
    """The monitor is called by the estimator, with every sample."""
    running.fly(STARTED_S)
    running.fly_until_heard("odometry", "prediction")
    running.forget()
    assert running.set_parameter("alarm_rate_hz", MONITOR_FAILS_HZ).successful
    span = running.fly(1.5)
    assert_whole(running, "odometry", *span)
    assert not len(running.stamps("prediction", *span))
    status = running.await_status("monitor: callbacks", DiagnosticStatus.ERROR, "as 123 asks for")
    assert int(values_of(status)["take_estimate"]) > 100
    assert running.latest("estimator: callbacks") is None
    assert running.set_parameter("alarm_rate_hz", ESTIMATOR_FAILS_HZ).successful
    running.fly(1.5)
    running.await_status("estimator: callbacks", DiagnosticStatus.ERROR, "as 321 asks for")
    # The monitor is whole again, and says what was.
    running.await_status("monitor: callbacks", DiagnosticStatus.WARN, "exceptions so far")
    assert running.set_parameter("alarm_rate_hz", 10.0).successful
    running.fly_until_heard("odometry", "prediction")
    assert_whole(running, "prediction", *running.fly(0.3))
    assert_alive(running.nodes)
