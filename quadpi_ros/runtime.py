# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What every process of quadpi_ros shares: quality of service, and a life from start to shutdown."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from quadpi_core.errors import QuadpiError
from quadpi_core.messages import qos
from quadpi_ros.callbacks import GuardedNode
from quadpi_ros.lifecycle import ManagedNode, start


def _profile(offered: qos.Qos) -> QoSProfile:
    return QoSProfile(
        depth=offered.depth,
        reliability=ReliabilityPolicy.RELIABLE if offered.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if offered.latched else DurabilityPolicy.VOLATILE,
    )


SENSOR_QOS, OUTPUT_QOS, LOG_QOS = (_profile(offered) for offered in (qos.SENSOR, qos.OUTPUT, qos.LOG))

# As tf2 offers and hears static transforms.
TRANSFORMS_QOS = QoSProfile(
    depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

# EventsExecutor does not wake on a signal; this is how long a shutdown may go unnoticed.
_SHUTDOWN_POLL_S = 0.2


class ArgumentError(QuadpiError):
    """ROS cannot use the arguments after `--ros-args`."""


def initialise() -> None:
    """Initialise ROS from the command line.

    Raises:
        ArgumentError: saying which argument is wrong.
    """
    try:
        rclpy.init()
    except UnknownROSArgsError as error:
        raise ArgumentError(f"unknown ROS arguments {error}") from None
    except RCLError as error:
        reason = str(error).partition(", at ")[0].removeprefix("failed to initialize rcl: ")
        raise ArgumentError(reason) from None


def serve(nodes: Sequence[ManagedNode[Any]]) -> None:
    """Bring up those nodes that start by themselves, and spin.

    Raises:
        QuadpiError: if one of them cannot start.
    """
    start(nodes)
    spin(nodes)


def spin(nodes: Sequence[Node]) -> None:
    """Serve the nodes on one EventsExecutor until the context shuts down, as on Ctrl-C.

    What their callbacks raise, guarded nodes keep to themselves; an exception of rclpy's own, as where it
    takes a request apart, is logged and counted by all of them, and ends none.
    """
    guarded = [node for node in nodes if isinstance(node, GuardedNode)]
    executor = EventsExecutor()
    for node in nodes:
        executor.add_node(node)
    # What exists by now stays: the garbage collector need not walk through it in flight.
    gc.collect()
    gc.freeze()
    never = Future()
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


def run(work: Callable[[], None]) -> int:
    """Do the work of a process between start and shutdown of ROS, and return the exit status.

    Errors that a user can mend print one line and give status 2.
    """
    try:
        initialise()
        work()
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except QuadpiError as error:
        print(f"quadpi: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    return 0
