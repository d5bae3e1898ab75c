# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Exceptions in callbacks: logged, counted in the diagnostics, and the end of nothing."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from std_msgs.msg import String
from std_srvs.srv import Trigger

from quadpi_core.monitor.health import TopicReport
from quadpi_ros import callbacks, sensor_node
from quadpi_ros.callbacks import (
    ERROR,
    OK,
    SENSOR_QOS,
    WARN,
    DiscoveryError,
    GuardedNode,
    SlowService,
    await_listeners,
    await_subscribers,
)
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


# Statuses for /diagnostics: what is said of a topic, and of which vehicle.


SOUND = {
    "samples": 500,
    "total": 4000,
    "rate_hz": 499.6,
    "stamp_rate_hz": 500.0,
    "gaps": 0,
    "longest_gap_s": 0.0,
    "newest_ns": 7,
    "refused_now": 0,
    "refused": {},
}
REFUSED = {"refused_now": 3, "refused": {"no unit quaternion": 3, "stamp jumped": 2}}


def status_of(report: dict[str, Any], **given: Any) -> Any:
    """The status of a topic that is required, whose nominal rate is 500 Hz."""
    settings: dict[str, Any] = {"required": True, "rate_hz": 500.0, "mismatch": None, "values": {}}
    return callbacks.topic_status("imu", TopicReport(**SOUND | report), **settings | given)


@pytest.mark.parametrize(
    ("report", "given", "level", "message"),
    [
        ({}, {}, OK, "500 Hz"),
        ({"samples": 0}, {}, ERROR, "nothing arrives"),
        ({"samples": 0}, {"required": False}, OK, "nothing arrives"),
        ({"samples": 0}, {"mismatch": "other type"}, ERROR, "other type"),
        # One that is heard by now is no mismatch any more.
        ({}, {"mismatch": "other type"}, OK, "500 Hz"),
        ({"stamp_rate_hz": 400.0}, {}, ERROR, "stamps say 400 Hz, imu_rate_hz is 500: set it to 0"),
        ({"stamp_rate_hz": 400.0}, {"rate_hz": None}, OK, "500 Hz"),
        (REFUSED, {}, WARN, "3 samples refused in the last second"),
        ({"samples": 0, **REFUSED}, {}, WARN, "3 samples refused in the last second"),
        ({"gaps": 2, "longest_gap_s": 0.25}, {}, WARN, "2 gaps, the longest 0.250 s"),
        # The worst is said.
        ({"gaps": 2, **REFUSED}, {}, WARN, "3 samples refused in the last second"),
    ],
)
def test_what_is_wrong_with_a_topic_is_said(
    report: dict[str, Any], given: dict[str, Any], level: bytes, message: str
) -> None:
    status = status_of(report, **given)
    assert (status.level, status.message) == (level, message)


@pytest.mark.parametrize(
    ("rate_hz", "samples", "differs"),
    [(545.0, 500, False), (555.0, 500, True), (445.0, 500, True), (700.0, 20, True), (700.0, 19, False)],
)
def test_stamps_of_another_rate_differ_by_a_tenth_in_twenty_samples(
    rate_hz: float, samples: int, differs: bool
) -> None:
    status = status_of({"stamp_rate_hz": rate_hz, "samples": samples})
    assert (status.level == ERROR) == differs


def test_values_are_short_and_name_every_refusal() -> None:
    given = {"stamp_age_s": 0.123456, "publishers": 2, "unknown": None}
    values = values_of(status_of({"stamp_rate_hz": None, **REFUSED}, values=given))
    assert values["samples"] == "4000"
    assert values["stamp_rate_hz"] == "unknown"
    assert (values["refused"], values["refused: stamp jumped"]) == ("5", "2")
    assert (values["stamp_age_s"], values["publishers"]) == ("0.1235", "2")


def test_a_message_type_is_named_as_in_the_graph() -> None:
    assert callbacks.type_name(Imu) == "sensor_msgs/msg/Imu"


def test_diagnostics_name_the_vehicle_and_whose_it_is(ros_domain: int) -> None:
    given = ("-p", "autostart:=false", "-p", "vehicle:=some/my-quad.yaml")
    with started(ros_domain, "-r", "__ns:=/uav1", *given):
        node = EstimatorNode()
        status = callbacks.status(callbacks.full_name(node, "state"), callbacks.OK, "", {})
        (told,) = callbacks.array(node, [status]).status
        node.destroy_node()
    assert (told.name, told.hardware_id) == ("uav1/estimator: state", "uav1/my-quad")


# Waiting for subscribers and managed nodes: what is missing is named.


# Long enough that discovery has settled, with nothing to find.
SHORT_S = 0.5
LONG_S = 60.0


@contextmanager
def spun(node):
    """A node that a thread of its own serves."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join()
        node.destroy_node()


def await_service(node):
    """Discovery may take longer than the tests below wait for an answer."""
    assert node.create_client(GetState, "estimator/get_state").wait_for_service(LONG_S)


@pytest.fixture
def node(ros):
    del ros
    with_publishers = Node("sender")
    yield with_publishers
    with_publishers.destroy_node()


def test_topics_without_a_subscriber_are_named(node):
    node.create_subscription(Imu, "heard", lambda _: None, SENSOR_QOS)
    publishers = [node.create_publisher(Imu, name, SENSOR_QOS) for name in ("heard", "unheard", "neither")]
    await_subscribers(node, publishers[:1], LONG_S)
    with pytest.raises(DiscoveryError, match=r"^nobody subscribed to /neither, /unheard in time$"):
        await_subscribers(node, publishers, SHORT_S)


def test_a_node_that_does_not_run_is_named(node):
    # Estimators of tests before may be there until they are collected.
    with pytest.raises(DiscoveryError, match=r"^node nobody does not run$"):
        await_listeners(node, [], ["nobody"], SHORT_S)


def test_a_node_that_hangs_is_named(node):
    unspun = Node("managed")
    unspun.create_service(GetState, "estimator/get_state", lambda _, response: response)
    await_service(node)
    with pytest.raises(DiscoveryError, match=r"^node estimator runs, but does not answer$"):
        await_listeners(node, [], ["estimator"], 3.0 * SHORT_S)
    unspun.destroy_node()


@pytest.mark.parametrize("state", [State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE])
def test_a_node_that_runs_must_be_active(node, state):
    """The one that is asked is served by a thread of its own."""
    managed = Node("managed")

    def answer(_, response):
        response.current_state.id = state
        response.current_state.label = "inactive"
        return response

    managed.create_service(GetState, "estimator/get_state", answer)
    managed.create_subscription(Imu, "imu", lambda _: None, SENSOR_QOS)
    with spun(managed):
        await_service(node)
        publisher = node.create_publisher(Imu, "imu", SENSOR_QOS)
        if state == State.PRIMARY_STATE_ACTIVE:
            await_listeners(node, [publisher], ["estimator"], LONG_S)
            assert publisher.get_subscription_count() == 1
        else:
            with pytest.raises(DiscoveryError, match=r"^node estimator is inactive, not active$"):
                await_listeners(node, [publisher], ["estimator"], 3.0 * SHORT_S)


# Last: its nodes run until the end of this file, and have the names that are asked for above.


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
