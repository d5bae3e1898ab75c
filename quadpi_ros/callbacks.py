# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that survive exceptions in their callbacks: each one is logged, counted and reported.

An exception that leaves a callback ends `spin` of rclpy's events executor, with it every node of the process,
and drops the events that were queued. So exceptions are caught around each callback, including those of
rclpy's own services for parameters and the lifecycle, which a client can make raise.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable
from copy import copy
from functools import wraps
from typing import Any, cast

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.event_handler import EventHandler
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer

from quadpi_core.errors import one_line
from quadpi_ros import diagnostics
from quadpi_ros.dds_profile import check_overrides, overriding_options

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
        text = f"exception in {self._latest}"
        if due_s is None:
            text += "\n" + "".join(traceback.format_exception(error))
        else:
            text += f" ({self.counts[where]} so far)"
        self._node.get_logger().error(text)

    def statuses(self) -> list[DiagnosticStatus]:
        """Status for `/diagnostics`: none before the first exception, ERROR for new ones, else WARN."""
        total = self.counts.total()
        if not total:
            return []
        new, self._reported = total - self._reported, total
        level = diagnostics.ERROR if new else diagnostics.WARN
        text = f"{new} exceptions in the last second" if new else f"{total} exceptions so far"
        name = diagnostics.full_name(self._node, "callbacks")
        return [diagnostics.status(name, level, f"{text}, the last in {self._latest}", self.counts)]


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
