# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Base of the managed nodes: parameters at construction, four hooks, errors of users in one line."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence
from typing import Any, Generic

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from quadpi_core.errors import QuadpiError
from quadpi_ros.callbacks import GuardedNode
from quadpi_ros.parameters import Parameters, ParameterServer


class ManagedNode(GuardedNode, LifecycleNode, Generic[Parameters]):
    """A lifecycle node that comes up by itself, unless its parameter `autostart` is false.

    Subclasses override :meth:`configure`, :meth:`activate`, :meth:`deactivate` and :meth:`cleanup`; the last
    two also undo what an attempt that failed has left, so they must not rely on it being whole.

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
        """The values as they stand."""
        return self._parameter_server.values

    def configure(self) -> None:
        """Load what is needed and create the publishers."""

    def activate(self) -> None:
        """Begin to listen."""

    def deactivate(self) -> None:
        """Stop listening."""

    def cleanup(self) -> None:
        """Free what :meth:`configure` made."""

    def parameters_changed(self) -> None:
        """Follow a change in flight of :attr:`parameters`."""

    def must(self, trigger: Callable[[], TransitionCallbackReturn]) -> None:
        """Go through a transition at the start of the process.

        Raises:
            QuadpiError: saying what the user can mend.
            Exception: whatever else the transition met.
        """
        self._starting = True
        self._failure = None
        trigger()
        if self._failure is not None:
            raise self._failure
        self._starting = False

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Configure; what a failed attempt left is undone."""
        return self._attempt(self.configure, "inactive", undo=(self.cleanup,))

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Activate; what a failed attempt left is undone."""
        return self._attempt(self.activate, "active", undo=(self.deactivate,))

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate."""
        return self._attempt(self.deactivate, "inactive")

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Clean up."""
        return self._attempt(self.cleanup, "unconfigured")

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Undo everything, whatever the state."""
        return self._attempt(self._undo_all, "finalized")

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Undo everything after an error in a transition: the node can be configured again."""
        return self._attempt(self._undo_all, "unconfigured")

    def _undo_all(self) -> None:
        self.deactivate()
        self.cleanup()

    def _attempt(
        self, step: Callable[[], None], goal: str, undo: Sequence[Callable[[], None]] = ()
    ) -> TransitionCallbackReturn:
        """Run one transition; rclpy itself would drop its exception without a word."""
        try:
            step()
        except QuadpiError as error:
            self._failure = error
            for back in undo:
                back()
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
    """Configure those nodes that start by themselves, which takes seconds, then activate them.

    Raises:
        QuadpiError: if one of them cannot start.
    """
    starting = [node for node in nodes if node.parameters.autostart]
    for node in starting:
        node.must(node.trigger_configure)
    for node in starting:
        node.must(node.trigger_activate)
