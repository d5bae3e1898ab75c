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
from quadpi_ros.dds_profile import check_overrides, overridden

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


def guarded(method: Callable[..., None]) -> Callable[..., None]:
    """Attribute exceptions of a method that another node calls to the method's node, not to the caller."""

    @wraps(method)
    def call(node: GuardedNode, *arguments: Any) -> None:
        try:
            method(node, *arguments)
        except Exception as error:
            node.exceptions.take(method.__name__, error)

    return call


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
        super().__init__(*arguments, automatically_declare_parameters_from_overrides=True, **options)
        check_overrides(self)
        self.exceptions = CaughtExceptions(self)
        # Those that rclpy created in its constructor.
        own: list[Service | Subscription | Timer] = [*self.services, *self.subscriptions, *self.timers]
        for entity in own:
            self._guard_entity(entity)

    @property
    def _is_set_up(self) -> bool:
        """Whether rclpy's constructor has returned; :meth:`__init__` guards what that created."""
        return hasattr(self, "exceptions")

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

    def _guard_entity(self, entity: Service | Subscription | Timer) -> None:
        if isinstance(entity, Service):
            # A client waits for an answer even after an exception.
            entity.callback = self.guard(f"service {entity.srv_name}", entity.callback, _empty)
        elif isinstance(entity, Subscription):
            entity.callback = self.guard(f"topic {entity.topic_name}", entity.callback)
        else:
            entity.callback = self.guard(f"timer {entity.callback.__name__}", entity.callback)

    def create_service(self, *arguments: Any, **options: Any) -> Service:
        """As rclpy's, guarded."""
        service = super().create_service(*arguments, **options)
        if self._is_set_up:
            self._guard_entity(service)
        return service

    def create_timer(self, *arguments: Any, **options: Any) -> Timer:
        """As rclpy's, guarded."""
        timer = super().create_timer(*arguments, **options)
        if self._is_set_up:
            self._guard_entity(timer)
        return timer

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        qos_profile: QoSProfile | int,
        **options: Any,
    ) -> Subscription:
        """As rclpy's, guarded, with the quality of service of `qos_overrides`."""
        if self._is_set_up:
            qos_profile, options = overridden(self, "subscription", topic, qos_profile, options)
        subscription = super().create_subscription(msg_type, topic, callback, qos_profile, **options)
        if self._is_set_up:
            self._guard_entity(subscription)
        return subscription

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: QoSProfile | int, **options: Any
    ) -> Publisher:
        """As rclpy's, with the quality of service of `qos_overrides`."""
        if self._is_set_up:
            qos_profile, options = overridden(self, "publisher", topic, qos_profile, options)
        return super().create_publisher(msg_type, topic, qos_profile, **options)

    def add_waitable(self, waitable: Any) -> None:
        """As rclpy's; events of publishers and subscriptions are guarded."""
        if self._is_set_up and isinstance(waitable, EventHandler):
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
        self._send = self._service.send_response
        # rclpy sends what the callback returns; here that is a promise of the response.
        self._service.send_response = self._send_when_kept

    def destroy(self) -> None:
        """Withdraw the service; requests in progress get no answer."""
        self._node.destroy_service(self._service)
        self._service = None

    def _take(self, request: Any, response: Any) -> Future:
        promise = Future()
        threading.Thread(target=self._run, args=(request, response, promise), daemon=True).start()
        return promise

    def _run(self, request: Any, response: Any, promise: Future) -> None:
        with self._one_at_a_time:
            fill = self._work(request)
        executor = self._node.executor
        if executor is not None:
            executor.create_task(lambda: self._keep(fill, response, promise))

    def _keep(self, fill: Callable[[Any], None], response: Any, promise: Future) -> None:
        if self._service is not None:
            self._node.guard(self._where, fill)(response)
            promise.set_result(response)

    def _send_when_kept(self, promise: Future, header: Any) -> None:
        promise.add_done_callback(lambda kept: self._send(kept.result(), header))
