# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What controls a player while it plays: services, a parameter and keys; and the clock that it publishes.

Names, keys and what they do are those of `ros2 bag play`. The services are of type std_srvs/Trigger, as
rosbag2_interfaces comes with rosbag2 alone, and the rate is a parameter.
"""

from __future__ import annotations

import os
import re
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable
from contextlib import suppress

from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService
from rclpy.task import Future
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from quadpi_ros.callbacks import GuardedNode
from quadpi_ros.node_parameters import PlayerParameters
from quadpi_ros.parameters import ParameterServer
from quadpi_ros.playback import Playback

KEYS_HELP = "space: pause, resume; →: next message while paused; ↑ ↓: 10 % faster, slower"

_POLL_S = 0.1
# Arrows are sequences of three bytes.
_KEY = re.compile(rb"\x1b\[[A-D]|.", re.DOTALL)
_FASTER = 1.1


class Controls:
    """Serves a playback from a thread of its own; a context manager.

    Args:
        node: on no executor.
        playback: to control.
        start_ns: stamp of the position 0 on `/clock`.
        clock_hz: rate of `/clock`; None: it is not published.
        keys: whether the keys of the terminal control it too, if there is one.
    """

    def __init__(
        self, node: GuardedNode, playback: Playback, start_ns: int, clock_hz: float | None, keys: bool
    ) -> None:
        self._node, self._playback, self._start_ns = node, playback, start_ns
        self._parameters = ParameterServer(node, PlayerParameters, self._follow_rate)
        self._follow_rate()
        self._clock = None if clock_hz is None else node.create_publisher(ClockMessage, "/clock", 10)
        self._clock_hz = clock_hz
        self._executor = EventsExecutor(context=node.context)
        self._closing = threading.Event()
        self._threads = [threading.Thread(target=self._spin, name="player's services")]
        self._terminal = _terminal() if keys else None
        if self._terminal is not None:
            self._threads.append(threading.Thread(target=self._read_keys, name="keys"))

    def __enter__(self) -> Controls:
        """Offer the services: from here on they are answered."""
        self._service = ParameterService(self._node)
        for name, change in (
            ("pause", self._playback.pause),
            ("resume", self._playback.resume),
            ("toggle_paused", self.toggle),
        ):
            self._node.create_service(Trigger, f"~/{name}", self._after(change))
        self._node.create_service(Trigger, "~/is_paused", self._tell_paused)
        self._node.create_service(Trigger, "~/play_next", self._play_next)
        if self._clock is not None and self._clock_hz is not None:
            self.tick()
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._node.create_timer(1.0 / self._clock_hz, self.tick, clock=steady)
        self._executor.add_node(self._node)
        if self._terminal is not None:
            self._before = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal)
            print(KEYS_HELP, flush=True)
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        for thread in self._threads:
            thread.join()
        if self._terminal is not None:
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)
        self._executor.remove_node(self._node)
        self._executor.shutdown()

    def toggle(self) -> None:
        """Pause or resume."""
        if self._playback.paused:
            self._playback.resume()
        else:
            self._playback.pause()

    def tick(self) -> None:
        """Publish the position as the time."""
        sec, nanosec = divmod(self._start_ns + self._playback.position_ns, 10**9)
        message = ClockMessage()
        message.clock.sec, message.clock.nanosec = sec, nanosec
        if self._clock is not None:
            self._clock.publish(message)

    def _follow_rate(self) -> None:
        self._playback.change_rate(self._parameters.values.rate)

    def _after(self, change: Callable[[], None]) -> Callable[[object, Trigger.Response], Trigger.Response]:
        def answer(_: object, response: Trigger.Response) -> Trigger.Response:
            change()
            response.success, response.message = True, self._where()
            return response

        return answer

    def _tell_paused(self, _: object, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._playback.paused, self._where()
        return response

    def _play_next(self, _: object, response: Trigger.Response) -> Trigger.Response:
        response.success = self._playback.step()
        response.message = self._where() if response.success else "not paused"
        return response

    def _where(self) -> str:
        state = "paused" if self._playback.paused else f"playing at {self._playback.rate:g} x real time"
        return f"{state}, at {1e-9 * self._playback.position_ns:.3f} s"

    def _spin(self) -> None:
        never = Future()
        # A signal ends ROS in the middle of a turn.
        with suppress(ExternalShutdownException):
            while self._node.context.ok() and not self._closing.is_set():
                self._executor.spin_until_future_complete(never, timeout_sec=_POLL_S)

    def _read_keys(self) -> None:
        assert self._terminal is not None
        actions: dict[bytes, Callable[[], object]] = {
            b" ": self.toggle,
            b"\x1b[C": self._playback.step,
            b"\x1b[A": lambda: self._ask_rate(_FASTER),
            b"\x1b[B": lambda: self._ask_rate(1.0 / _FASTER),
        }
        while not self._closing.is_set():
            if not select.select([self._terminal], [], [], _POLL_S)[0]:
                continue
            pressed = os.read(self._terminal, 64)
            if not pressed:
                return
            for key in _KEY.findall(pressed):
                if key in actions:
                    actions[key]()
                    print(self._where(), flush=True)

    def _ask_rate(self, factor: float) -> None:
        (result,) = self._node.set_parameters([Parameter("rate", value=self._playback.rate * factor)])
        if not result.successful:
            print(result.reason, file=sys.stderr, flush=True)


def _terminal() -> int | None:
    """Descriptor of the terminal whose keys reach this process; None without one, or in the background."""
    if not sys.stdin.isatty():
        return None
    descriptor = sys.stdin.fileno()
    return descriptor if os.tcgetpgrp(descriptor) == os.getpgrp() else None
