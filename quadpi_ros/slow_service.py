# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A service whose answer takes time, while the executor goes on with the samples."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, cast

from rclpy.task import Future

from quadpi_ros.callbacks import GuardedNode


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
