# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Life of a process and of its managed nodes: from the start through the transitions to the shutdown."""

from __future__ import annotations

import gc
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from typing import Any, Generic

import rclpy
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.task import Future

from quadpi_core.errors import QuadpiError
from quadpi_ros.callbacks import GuardedNode
from quadpi_ros.parameters import Parameters, ParameterServer

# EventsExecutor does not wake up on a signal; a shutdown is noticed within this time.
_SHUTDOWN_POLL_S = 0.2


class ManagedNode(GuardedNode, LifecycleNode, Generic[Parameters]):
    """A lifecycle node that configures and activates itself unless its parameter `autostart` is false.

    Subclasses override :meth:`configure`, :meth:`activate`, :meth:`deactivate` and :meth:`cleanup`. The last
    two also run after a failed attempt at the first two, so they must cope with a partial set-up.

    Args:
        name: of the node.
        parameters: dataclass of its parameters.

    Raises:
        ParameterError: see :class:`quadpi_ros.parameters.ParameterServer`.
    """

    def __init__(self, name: str, parameters: type[Parameters]) -> None:
        super().__init__(name)
        self.state = "unconfigured"
        self._starting = False
        self._failure: Exception | None = None
        self._parameter_server = ParameterServer(self, parameters, self._change)

    @property
    def parameters(self) -> Parameters:
        """Current values."""
        return self._parameter_server.values

    def configure(self) -> None:
        """Load files and create the publishers."""

    def activate(self) -> None:
        """Create the subscriptions."""

    def deactivate(self) -> None:
        """Destroy the subscriptions."""

    def cleanup(self) -> None:
        """Destroy what :meth:`configure` created."""

    def parameters_changed(self) -> None:
        """Apply a change of :attr:`parameters` while the node runs."""

    def must(self, trigger: Callable[[], TransitionCallbackReturn]) -> None:
        """Make a transition at the start of the process, where failure ends the process.

        Raises:
            QuadpiError: for what a user can correct.
            Exception: any other error of the transition.
        """
        self._starting = True
        self._failure = None
        trigger()
        if self._failure is not None:
            raise self._failure
        self._starting = False

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Configure; a failed attempt is undone."""
        return self._attempt(self.configure, "inactive", undo=(self.cleanup,))

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Activate; a failed attempt is undone."""
        return self._attempt(self.activate, "active", undo=(self.deactivate,))

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate."""
        return self._attempt(self.deactivate, "inactive")

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Clean up."""
        return self._attempt(self.cleanup, "unconfigured")

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate and clean up from any state."""
        return self._attempt(self._undo_all, "finalized")

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate and clean up after an error in a transition; the node can be configured again."""
        return self._attempt(self._undo_all, "unconfigured")

    def _undo_all(self) -> None:
        self.deactivate()
        self.cleanup()

    def _attempt(
        self, step: Callable[[], None], goal: str, undo: Sequence[Callable[[], None]] = ()
    ) -> TransitionCallbackReturn:
        """Run one transition and log its exception, which rclpy would swallow."""
        try:
            step()
        except QuadpiError as error:
            self._failure = error
            for undo_step in undo:
                undo_step()
            if not self._starting:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self._failure = error
            if not self._starting:
                self.get_logger().error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        self.state = goal
        return TransitionCallbackReturn.SUCCESS

    def _change(self) -> None:
        if self.state in ("inactive", "active"):
            self.parameters_changed()


def start(nodes: Sequence[ManagedNode[Any]]) -> None:
    """Configure all nodes with `autostart`, which takes seconds, then activate them.

    Raises:
        QuadpiError: if one of them cannot start.
    """
    starting = [node for node in nodes if node.parameters.autostart]
    for node in starting:
        node.must(node.trigger_configure)
    for node in starting:
        node.must(node.trigger_activate)


class ArgumentError(QuadpiError):
    """The arguments after `--ros-args` are invalid."""


# Whether an executor spins, by which a Python exception of a signal would come to C++: it prints a traceback,
# or aborts.
_SPINNING = threading.Event()


def _interrupted(*_: object) -> None:
    if not _SPINNING.is_set():
        raise KeyboardInterrupt


def initialise() -> None:
    """Initialise ROS from the command line.

    Raises:
        ArgumentError: saying which argument is wrong.
    """
    if threading.current_thread() is threading.main_thread():
        # Before that of rclpy, which ends ROS and then calls it.
        signal.signal(signal.SIGINT, _interrupted)
    try:
        rclpy.init()
    except UnknownROSArgsError as error:
        raise ArgumentError(f"unknown ROS arguments {error}") from None
    except RCLError as error:
        reason = str(error).partition(", at ")[0].removeprefix("failed to initialize rcl: ")
        raise ArgumentError(reason) from None


def serve(nodes: Sequence[ManagedNode[Any]]) -> None:
    """Start the nodes with `autostart`, then spin all of them.

    Raises:
        QuadpiError: if one of them cannot start.
    """
    start(nodes)
    spin(nodes)


def spin(nodes: Sequence[Node]) -> None:
    """Spin the nodes on one EventsExecutor until the context shuts down, as on Ctrl-C.

    Guarded nodes catch the exceptions of their callbacks. An exception of rclpy itself, as on a malformed
    request, is logged and counted by all guarded nodes and ends none of them.
    """
    guarded = [node for node in nodes if isinstance(node, GuardedNode)]
    executor = EventsExecutor()
    for node in nodes:
        executor.add_node(node)
    # What exists now is never garbage: exclude it from collections in flight.
    gc.collect()
    gc.freeze()
    never = Future()
    _SPINNING.set()
    try:
        while rclpy.ok():
            try:
                executor.spin_until_future_complete(never, timeout_sec=_SHUTDOWN_POLL_S)
            except ExternalShutdownException:
                raise
            except Exception as error:
                if not guarded:
                    raise
                for node in guarded:
                    node.exceptions.take("executor", error)
    finally:
        _SPINNING.clear()


def run(work: Callable[[], None]) -> int:
    """Initialise ROS, do the work of the process, shut ROS down, and return the exit status.

    An error that the user can correct prints one line and gives status 2.
    """
    try:
        initialise()
        work()
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except RCLError:
        # A signal ends ROS in the middle of whatever goes on, such as the publication of a message.
        if rclpy.ok():
            raise
        return 0
    except QuadpiError as error:
        print(f"quadpi: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    return 0
