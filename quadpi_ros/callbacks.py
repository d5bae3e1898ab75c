# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes whose callbacks may fail without ending the process: an exception is logged, counted, and reported.

rclpy's events executor lets an exception out of `spin`, which ends every node of the process, and drops what
was queued behind it. So it is caught where the callback is called, also in the services that rclpy itself
offers for parameters and the lifecycle: a client can make those raise.
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

# A callback may fail at every sample; the log names it no more often than this.
_LOG_PERIOD_S = 5.0


class CaughtExceptions:
    """The exceptions that callbacks of a node raised.

    Attributes:
        counts: how many, by the callback that raised them.
    """

    def __init__(self, node: Node) -> None:
        self.counts: Counter[str] = Counter()
        self._node = node
        self._latest = ""
        self._reported = 0
        self._next_log_s: dict[tuple[str, str], float] = {}

    def take(self, where: str, error: Exception) -> None:
        """Count an exception and log it: with its traceback at first, in one line every few seconds later.

        Args:
            where: the callback that raised it.
            error: what it raised.
        """
        context = self._node.context
        if context is None or not context.ok():
            return  # the process ends, and with it what a callback may publish to
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
        """What `/diagnostics` says: nothing before the first exception; an error where one is new."""
        total = self.counts.total()
        if not total:
            return []
        new, self._reported = total - self._reported, total
        level = diagnostics.ERROR if new else diagnostics.WARN
        text = f"{new} exceptions in the last second" if new else f"{total} exceptions so far"
        name = diagnostics.full_name(self._node, "callbacks")
        return [diagnostics.status(name, level, f"{text}, the last in {self._latest}", self.counts)]


def guarded(method: Callable[..., None]) -> Callable[..., None]:
    """A method of a node that another node calls, whose exceptions are then its own and not the caller's."""

    @wraps(method)
    def call(node: GuardedNode, *arguments: Any) -> None:
        try:
            method(node, *arguments)
        except Exception as error:
            node.exceptions.take(method.__name__, error)

    return call


class GuardedNode(Node):
    """A node that goes on after an exception in a callback, and whose topics take `qos_overrides`.

    Args:
        arguments: of rclpy's Node.
        options: of rclpy's Node.

    Attributes:
        exceptions: what its callbacks raised.

    Raises:
        QosOverrideError: for a wrong `qos_overrides`.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, automatically_declare_parameters_from_overrides=True, **options)
        check_overrides(self)
        self.exceptions = CaughtExceptions(self)
        # What rclpy has made for itself.
        own: list[Service | Subscription | Timer] = [*self.services, *self.subscriptions, *self.timers]
        for entity in own:
            self._guard_entity(entity)

    @property
    def _is_set_up(self) -> bool:
        """Whether rclpy is done with its own part, which :meth:`__init__` guards as a whole."""
        return hasattr(self, "exceptions")

    def guard(
        self, where: str, callback: Callable[..., Any], instead: Callable[..., Any] = lambda *_: None
    ) -> Callable[..., Any]:
        """A callback that raises no exception.

        Args:
            where: what the log and the diagnostics call it.
            callback: to be called.
            instead: gives the result after an exception, of the same arguments.
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
            # Its client waits for an answer.
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
        """As rclpy's, guarded, and with parameters that override its quality of service."""
        if self._is_set_up:
            qos_profile, options = overridden(self, "subscription", topic, qos_profile, options)
        subscription = super().create_subscription(msg_type, topic, callback, qos_profile, **options)
        if self._is_set_up:
            self._guard_entity(subscription)
        return subscription

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: QoSProfile | int, **options: Any
    ) -> Publisher:
        """As rclpy's, with parameters that override its quality of service."""
        if self._is_set_up:
            qos_profile, options = overridden(self, "publisher", topic, qos_profile, options)
        return super().create_publisher(msg_type, topic, qos_profile, **options)

    def add_waitable(self, waitable: Any) -> None:
        """As rclpy's; an event of a publisher or subscription is guarded."""
        if self._is_set_up and isinstance(waitable, EventHandler):
            waitable.callback = self.guard(f"event {waitable.event_type.name.lower()}", waitable.callback)
        super().add_waitable(waitable)


def _empty(_: Any, response: Any) -> Any:
    """The response to a request that raised an exception, which may have filled it in part."""
    return type(response)()


class SlowService:
    """Does the work of each request in a thread, one after another, and answers from the executor.

    Neither a callback that waits nor a coroutine would do: the first stops the samples, and the events
    executor does not await the second.

    Args:
        node: that offers the service; on an executor.
        service_type: of the service.
        name: of the service.
        work: called in the thread with the request; gives a function that fills the response. That one is
            called on the executor, between two samples. After an exception in either, the response is empty.
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
        # The executor sends what the callback returns; here that is a promise.
        self._service.send_response = self._send_when_kept

    def destroy(self) -> None:
        """Offer the service no longer; requests under way stay without an answer."""
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
