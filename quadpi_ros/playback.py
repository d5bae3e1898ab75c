# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The position in a bag that is played: it moves at a rate, stands still while paused, and can be set."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

# Whoever waits looks this often whether to go on: nothing wakes it up when ROS shuts down.
_GLANCE_S = 0.2


class Playback:
    """The position in a bag, in nanoseconds since its first message; shared by threads.

    Args:
        paused: whether it begins paused.
        position_ns: where it begins.
    """

    def __init__(self, paused: bool = False, position_ns: int = 0) -> None:
        self._changed = threading.Condition()
        self._rate, self._paused = 1.0, paused
        # The position at an instant of the monotonic clock.
        self._anchor_ns, self._at_ns = position_ns, time.monotonic_ns()
        # Messages that are still to be let through while paused.
        self._steps = 0

    @property
    def rate(self) -> float:
        """Speed; 1 is real time."""
        return self._rate

    @property
    def paused(self) -> bool:
        """Whether it stands still."""
        return self._paused

    @property
    def position_ns(self) -> int:
        """The position now."""
        with self._changed:
            return self._now_ns()

    def change_rate(self, rate: float) -> None:
        """Go on at another rate."""
        with self._changed:
            self._seek(self._now_ns())
            self._rate = rate

    def pause(self) -> None:
        """Stand still."""
        with self._changed:
            self._seek(self._now_ns())
            self._paused = True

    def resume(self) -> None:
        """Go on from where it stands still."""
        with self._changed:
            self._seek(self._now_ns())
            self._paused = False
            self._steps = 0

    def step(self) -> bool:
        """Let the next message through while paused; False if not paused."""
        with self._changed:
            self._steps += self._paused
            self._changed.notify_all()
            return self._paused

    def seek(self, position_ns: int) -> None:
        """Go to a position."""
        with self._changed:
            self._seek(position_ns)

    def wait_until(self, due_ns: int, going: Callable[[], bool]) -> bool:
        """Wait until a message is due.

        Args:
            due_ns: position of the message.
            going: asked now and then whether to go on waiting.

        Returns:
            Whether it is due; False where waiting ended before.
        """
        with self._changed:
            while going():
                if self._paused and self._steps:
                    self._steps -= 1
                    self._seek(max(due_ns, self._now_ns()))
                    return True
                left_s = 1e-9 * (due_ns - self._now_ns()) / self._rate
                if left_s <= 0.0 and not self._paused:
                    return True
                self._changed.wait(_GLANCE_S if self._paused else min(left_s, _GLANCE_S))
        return False

    def _now_ns(self) -> int:
        passed_ns = 0 if self._paused else time.monotonic_ns() - self._at_ns
        return self._anchor_ns + round(passed_ns * self._rate)

    def _seek(self, position_ns: int) -> None:
        self._anchor_ns, self._at_ns = position_ns, time.monotonic_ns()
        self._changed.notify_all()
