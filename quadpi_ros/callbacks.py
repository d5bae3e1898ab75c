# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that survive exceptions in their callbacks: each one is logged, counted and reported.

An exception that leaves a callback ends `spin` of rclpy's events executor, with it every node of the process,
and drops the events that were queued. So exceptions are caught around each callback, including those of
rclpy's own services for parameters and the lifecycle, which a client can make raise.
"""

from __future__ import annotations

import re
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import wraps
from pathlib import Path
from typing import Any, Literal, cast

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.client import Client
from rclpy.event_handler import EventHandler
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer

from quadpi_core.errors import QuadpiError, one_line
from quadpi_core.messages import topics as qos
from quadpi_core.monitor.health import TopicReport

# Discovery has two sides: a publisher may already know a subscriber that does not know the publisher yet and
# drops its messages, on a busy machine for seconds. A participant announces its endpoints in the order of
# their creation. So a node that has answered a request of a client created after the publishers knows the
# publishers.

QOS_PREFIX = "qos_overrides."

# The policies that may be overridden, and the type of the value of each; None is a positive integer.
_VALUES: dict[QoSPolicyKind, type[HistoryPolicy | ReliabilityPolicy | DurabilityPolicy] | None] = {
    QoSPolicyKind.HISTORY: HistoryPolicy,
    QoSPolicyKind.DEPTH: None,
    QoSPolicyKind.RELIABILITY: ReliabilityPolicy,
    QoSPolicyKind.DURABILITY: DurabilityPolicy,
}
_NAME = re.compile(r"/[^.]+\.(?:publisher|subscription)\.(?P<policy>\w+)")

_POLL_S = 0.02
# When a publisher knows one subscriber, others may not have found each other yet: they do within this.
_MATCHED_S = 1.0
# A node that is being configured does not answer; after this time it is asked again.
_ANSWER_S = 1.0


def _profile(offered: qos.Qos) -> QoSProfile:
    return QoSProfile(
        depth=offered.depth,
        reliability=ReliabilityPolicy.RELIABLE if offered.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if offered.latched else DurabilityPolicy.VOLATILE,
    )


SENSOR_QOS, OUTPUT_QOS, LOG_QOS = (_profile(offered) for offered in (qos.SENSOR, qos.OUTPUT, qos.LOG))

# Whoever subscribes late gets the present one; static transforms as tf2 has them.
DESCRIPTION_QOS, TRANSFORMS_QOS = (
    QoSProfile(depth=depth, reliability=LOG_QOS.reliability, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for depth in (1, 100)
)


class QosOverrideError(QuadpiError):
    """A `qos_overrides` parameter has an unknown name or an invalid value."""


def check_overrides(node: Node) -> None:
    """Refuse invalid `qos_overrides`: rclpy raises deep inside for a wrong value and ignores a wrong name.

    Any topic is accepted, as a parameter file for several nodes names the topics of all of them.

    Args:
        node: its parameters are declared.

    Raises:
        QosOverrideError: naming the parameter.
    """
    policies = {kind.name.lower(): values for kind, values in _VALUES.items()}
    # rclpy annotates values, but returns parameters.
    given: Mapping[str, Any] = node.get_parameters_by_prefix(QOS_PREFIX[:-1])
    for name, parameter in given.items():
        where, value = f"node {node.get_name()}: parameter `{QOS_PREFIX}{name}`", parameter.value
        match = _NAME.fullmatch(name)
        if match is None or match["policy"] not in policies:
            raise QosOverrideError(
                f"{where} is none of {QOS_PREFIX}/TOPIC.publisher.POLICY and "
                f"{QOS_PREFIX}/TOPIC.subscription.POLICY, where POLICY is {', '.join(policies)}"
            )
        values = policies[match["policy"]]
        if values is None:
            right, expected = type(value) is int and value > 0, "a positive integer"
        else:
            names = [item.lower() for item in values.__members__ if item != "UNKNOWN"]
            right, expected = value in names, f"one of {', '.join(names)}"
        if not right:
            raise QosOverrideError(f"{where} must be {expected}, found {value!r}")


def overriding_options(
    node: Node, topic: str, end: Literal["publisher", "subscription"]
) -> QoSOverridingOptions:
    """For creating an endpoint: those policies for which a parameter of the node has a value."""
    prefix = f"{QOS_PREFIX}{node.resolve_topic_name(topic)}.{end}"
    return QoSOverridingOptions(
        [kind for kind in _VALUES if node.has_parameter(f"{prefix}.{kind.name.lower()}")]
    )


class DiscoveryError(QuadpiError):
    """No subscriber was found in time."""


def await_listeners(
    node: Node, publishers: Sequence[Publisher], managed: Sequence[str], wait_s: float
) -> None:
    """Wait until the managed nodes are active and every publisher has a subscriber.

    Args:
        node: owns the publishers; on no executor.
        publishers: each needs at least one subscriber.
        managed: names of lifecycle nodes, relative to the namespace of `node`. They know the publishers.
        wait_s: timeout.

    Raises:
        DiscoveryError: on timeout, naming what is missing.
    """
    deadline = time.monotonic() + wait_s
    executor = EventsExecutor(context=node.context)
    executor.add_node(node)
    try:
        for name in managed:
            client = node.create_client(GetState, f"{name}/get_state")
            _await_active(node, executor, client, name, deadline)
            node.destroy_client(client)
        await_subscribers(node, publishers, deadline - time.monotonic())
        if managed:
            time.sleep(_MATCHED_S)
    finally:
        executor.remove_node(node)
        executor.shutdown()


def _await_active(node: Node, executor: EventsExecutor, client: Client, name: str, deadline: float) -> None:
    found = "does not run"
    while node.context.ok():
        if time.monotonic() > deadline:
            raise DiscoveryError(f"node {name} {found}")
        if client.service_is_ready():
            answer = client.call_async(GetState.Request())
            executor.spin_until_future_complete(answer, timeout_sec=_ANSWER_S)
            state = answer.result().current_state if answer.done() else None
            if state is not None and state.id == State.PRIMARY_STATE_ACTIVE:
                return
            found = f"is {state.label}, not active" if state is not None else "runs, but does not answer"
            client.remove_pending_request(answer)
        time.sleep(_POLL_S)


def await_subscribers(node: Node, publishers: Sequence[Publisher], wait_s: float) -> None:
    """Wait until every publisher has a subscriber.

    Args:
        node: owns the publishers.
        publishers: to connect.
        wait_s: timeout.

    Raises:
        DiscoveryError: on timeout, naming the topics without a subscriber.
    """
    deadline = time.monotonic() + wait_s
    while node.context.ok():
        lonely = sorted(one.topic_name for one in publishers if one.get_subscription_count() == 0)
        if not lonely:
            return
        if time.monotonic() > deadline:
            raise DiscoveryError(f"nobody subscribed to {', '.join(lonely)} in time")
        time.sleep(_POLL_S)


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
STALE = DiagnosticStatus.STALE

# A relative error of the rate moves the cut-off of a low-pass by as much.
_RATE_TOLERANCE = 0.1
# With fewer samples the rate of the stamps is too uncertain to judge.
_RATE_SAMPLES_MIN = 20


def array(node: Node, statuses: Sequence[DiagnosticStatus]) -> DiagnosticArray:
    """Message with the statuses of a node, stamped now.

    Sets their `hardware_id` to the node's namespace and the name of its vehicle file, as several vehicles may
    share a file.

    Args:
        node: its parameter `vehicle` is the file.
        statuses: to send.
    """
    vehicle = Path(node.get_parameter_or("vehicle", Parameter("vehicle", value="")).value).stem
    for one in statuses:
        one.hardware_id = f"{node.get_namespace()}/{vehicle}".lstrip("/")
    message = DiagnosticArray(status=list(statuses))
    message.header.stamp = node.get_clock().now().to_msg()
    return message


def full_name(node: Node, name: str) -> str:
    """Name of a status, preceded by that of its node."""
    return f"{node.get_fully_qualified_name().lstrip('/')}: {name}"


def type_name(message_type: Any) -> str:
    """Name of a message type in the ROS graph, such as `sensor_msgs/msg/Imu`."""
    return f"{message_type.__module__.partition('.')[0]}/msg/{message_type.__name__}"


def status(name: str, level: bytes, message: str, values: Mapping[str, Any]) -> DiagnosticStatus:
    """A status; floats are rounded to four digits."""
    texts = {
        key: f"{value:.4g}" if isinstance(value, float) else "unknown" if value is None else str(value)
        for key, value in values.items()
    }
    told = [KeyValue(key=key, value=text) for key, text in texts.items()]
    return DiagnosticStatus(name=name, level=level, message=message, values=told)


def topic_status(
    name: str,
    report: TopicReport,
    *,
    required: bool,
    rate_hz: float | None,
    mismatch: str | None,
    values: Mapping[str, Any],
) -> DiagnosticStatus:
    """Status of a subscribed topic.

    Args:
        name: of the status.
        report: health of the topic since the last status.
        required: whether silence is an error.
        rate_hz: nominal rate, if one is set.
        mismatch: why a publisher is incompatible.
        values: further values to report.
    """
    level, message = OK, f"{report.rate_hz:.0f} Hz"
    if report.samples == 0 and mismatch:
        level, message = ERROR, mismatch
    elif report.samples == 0 and report.refused_now == 0:
        level, message = (ERROR if required else OK), "nothing arrives"
    elif _other_rate(report, rate_hz):
        level = ERROR
        message = f"stamps say {report.stamp_rate_hz:.0f} Hz, imu_rate_hz is {rate_hz:g}: set it to 0"
    elif report.refused_now:
        level, message = WARN, f"{report.refused_now} samples refused in the last second"
    elif report.gaps:
        level, message = WARN, f"{report.gaps} gaps, the longest {report.longest_gap_s:.3f} s"
    told = ("rate_hz", "stamp_rate_hz", "gaps", "longest_gap_s")
    topic = {"samples": report.total, **{key: getattr(report, key) for key in told}}
    topic |= {"refused": sum(report.refused.values())}
    topic |= {f"refused: {reason}": count for reason, count in report.refused.items()}
    return status(name, level, message, topic | dict(values))


def _other_rate(report: TopicReport, rate_hz: float | None) -> bool:
    if rate_hz is None or report.stamp_rate_hz is None or report.samples < _RATE_SAMPLES_MIN:
        return False
    return abs(report.stamp_rate_hz / rate_hz - 1.0) > _RATE_TOLERANCE


# A callback that fails at every sample is logged at this period.
_LOG_PERIOD_S = 5.0


class CaughtExceptions:
    """Exceptions raised by the callbacks of a node.

    Attributes:
        counts: number of exceptions by callback.
    """

    def __init__(self, node: Node) -> None:
        self.counts: Counter[str] = Counter()
        self._node = node
        self._latest = ""
        self._reported = 0
        self._next_log_s: dict[tuple[str, str], float] = {}

    def take(self, where: str, error: Exception) -> None:
        """Count and log an exception: the first of a kind with its traceback, later ones in a line every 5 s.

        Args:
            where: name of the callback.
            error: raised by it.
        """
        context = self._node.context
        if context is None or not context.ok():
            return  # raised because the process is shutting down
        self.counts[where] += 1
        self._latest = f"{where}: {type(error).__name__}: {one_line(error)}"
        now_s = time.monotonic()
        due_s = self._next_log_s.get((where, type(error).__name__))
        if due_s is not None and now_s < due_s:
            return
        self._next_log_s[where, type(error).__name__] = now_s + _LOG_PERIOD_S
        more = f" ({self.counts[where]} so far)"
        if due_s is None:
            more = "\n" + "".join(traceback.format_exception(error))
        self._node.get_logger().error(f"exception in {self._latest}{more}")

    def statuses(self) -> list[DiagnosticStatus]:
        """Status for `/diagnostics`: none before the first exception, ERROR for new ones, else WARN."""
        total = self.counts.total()
        if not total:
            return []
        new, self._reported = total - self._reported, total
        level = ERROR if new else WARN
        text = f"{new} exceptions in the last second" if new else f"{total} exceptions so far"
        name = full_name(self._node, "callbacks")
        return [status(name, level, f"{text}, the last in {self._latest}", self.counts)]


class GuardedNode(Node):
    """A node that continues after exceptions in callbacks and honours `qos_overrides` parameters.

    Args:
        arguments: positional arguments of rclpy's Node.
        options: keyword arguments of rclpy's Node.

    Attributes:
        exceptions: raised by its callbacks.

    Raises:
        QosOverrideError: for an invalid `qos_overrides` parameter.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.exceptions = CaughtExceptions(self)
        super().__init__(*arguments, automatically_declare_parameters_from_overrides=True, **options)
        check_overrides(self)
        # Not all that rclpy has created went through `create_service`.
        for service in self.services:
            service.callback = self.guard(f"service {service.srv_name}", service.callback, _empty)

    def guard(
        self, where: str, callback: Callable[..., Any], instead: Callable[..., Any] = lambda *_: None
    ) -> Callable[..., Any]:
        """Wrap a callback so that it raises no exception.

        Args:
            where: name of the callback in log and diagnostics.
            callback: to wrap.
            instead: called with the same arguments for a result if `callback` raises.
        """

        @wraps(callback)
        def call(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                self.exceptions.take(where, error)
                return instead(*arguments)

        return call

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Service:
        """As rclpy's, guarded: a client gets an answer even after an exception."""
        callback = self.guard(f"service {srv_name}", callback, _empty)
        return super().create_service(srv_type, srv_name, callback, **options)

    def create_timer(self, timer_period_sec: float, callback: Any, *rest: Any, **options: Any) -> Timer:
        """As rclpy's, guarded."""
        callback = self.guard(f"timer {callback.__name__}", callback)
        return super().create_timer(timer_period_sec, callback, *rest, **options)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, qos_profile: QoSProfile | int, **options: Any
    ) -> Subscription:
        """As rclpy's, guarded, with the quality of service of `qos_overrides`."""
        callback = self.guard(f"topic {self.resolve_topic_name(topic)}", callback)
        overriding = overriding_options(self, topic, "subscription")
        return super().create_subscription(
            msg_type, topic, callback, copy(qos_profile), qos_overriding_options=overriding, **options
        )

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: QoSProfile | int, **options: Any
    ) -> Publisher:
        """As rclpy's, with the quality of service of `qos_overrides`."""
        overriding = overriding_options(self, topic, "publisher")
        return super().create_publisher(
            msg_type, topic, copy(qos_profile), qos_overriding_options=overriding, **options
        )

    def add_waitable(self, waitable: Any) -> None:
        """As rclpy's; events of publishers and subscriptions are guarded."""
        if isinstance(waitable, EventHandler):
            waitable.callback = self.guard(f"event {waitable.event_type.name.lower()}", waitable.callback)
        super().add_waitable(waitable)


def _empty(_: Any, response: Any) -> Any:
    """A fresh response, as the one of a request that raised may be half filled."""
    return type(response)()


class SlowService:
    """A service whose requests are worked on in a thread, one at a time, while samples are processed.

    A callback that blocks would delay samples, and the events executor does not await coroutines.

    Args:
        node: offers the service; must be on an executor.
        service_type: of the service.
        name: of the service.
        work: called in the thread with the request; returns a function that fills the response, which is
            called on the executor between two samples. If either raises, the response is empty.
    """

    def __init__(
        self,
        node: GuardedNode,
        service_type: type,
        name: str,
        work: Callable[[Any], Callable[[Any], None]],
    ) -> None:
        self._node = node
        self._where = f"service {name}"
        self._work = node.guard(self._where, work, lambda _: lambda _: None)
        self._one_at_a_time = threading.Lock()
        self._service = cast(Any, node.create_service(service_type, name, self._take))
        send = self._service.send_response
        # rclpy sends what the callback returns; here that is a promise of the response.
        self._service.send_response = lambda promise, header: promise.add_done_callback(
            lambda kept: send(kept.result(), header)
        )

    def destroy(self) -> None:
        """Withdraw the service; requests in progress get no answer."""
        self._node.destroy_service(self._service)
        self._service = None

    def _take(self, request: Any, response: Any) -> Future:
        promise = Future()

        def run() -> None:
            with self._one_at_a_time:
                fill = self._work(request)
            if self._node.executor is not None:
                self._node.executor.create_task(keep, fill)

        def keep(fill: Callable[[Any], None]) -> None:
            if self._service is not None:
                self._node.guard(self._where, fill)(response)
                promise.set_result(response)

        threading.Thread(target=run, daemon=True).start()
        return promise
