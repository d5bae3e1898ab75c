# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Work at a steady period, done even where messages come faster than they can be taken.

rclpy's events executor takes what happens in its order. Once more messages arrive than a process can take, a
timer waits behind all of them, longer and longer: neither diagnostics nor an alarm would say so.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType

from quadpi_ros.callbacks import GuardedNode

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
# Shares of the period: sooner after the work a timer has nothing to do, later a message does what is due.
_EARLY, _LATE = 0.5, 1.5


class Watch:
    """Work that a timer does once per period, or :meth:`look` where the timer is late.

    Args:
        node: on whose executor it is done.
        period_s: by this computer's steady clock, not by the node's.
        work: to be done.
    """

    def __init__(self, node: GuardedNode, period_s: float, work: Callable[[], None]) -> None:
        self._node, self._period_s, self._done_s = node, period_s, time.monotonic()
        self._work = node.guard(f"watch {work.__name__}", work)
        self._timer = node.create_timer(period_s, self._on_time, clock=STEADY)

    def look(self, now_s: float) -> None:
        """Do what is overdue by this instant of the steady clock; called at every message."""
        if now_s - self._done_s > _LATE * self._period_s:
            self._do(now_s)

    def destroy(self) -> None:
        """Stop."""
        self._node.destroy_timer(self._timer)

    def _on_time(self) -> None:
        now_s = time.monotonic()
        if now_s - self._done_s > _EARLY * self._period_s:
            self._do(now_s)

    def _do(self, now_s: float) -> None:
        self._done_s = now_s
        self._work()
