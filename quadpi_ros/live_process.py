# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Estimator and monitor in one process, on one executor: the default on a vehicle.

The estimator passes each state to the monitor directly instead of over DDS, and publishes odometry as well.
"""

from __future__ import annotations

from typing import Any

from quadpi_ros.estimator_node import EstimatorNode
from quadpi_ros.monitor_node import MonitorNode
from quadpi_ros.runtime import ManagedNode, run, serve


def create_nodes() -> list[ManagedNode[Any]]:
    """Estimator and monitor, connected."""
    estimator = EstimatorNode()
    return [estimator, MonitorNode(estimator)]


def main() -> int:
    """Run the process."""
    return run(lambda: serve(create_nodes()))


if __name__ == "__main__":
    raise SystemExit(main())
