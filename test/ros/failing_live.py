# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The live nodes, with errors in the program: `python failing_live.py --ros-args …`.

While the node `monitor` has an alarm_rate_hz of 123, all that it does with a sample raises an exception;
while it has one of 321, so does all that the estimator does with a pose.
"""

from __future__ import annotations

from typing import Any

from quadpi_ros.live_process import create_nodes
from quadpi_ros.runtime import run, serve

MONITOR_FAILS_HZ, ESTIMATOR_FAILS_HZ = 123.0, 321.0


def main() -> int:
    """Run the process."""

    def work() -> None:
        estimator, monitor = create_nodes()

        def failing(method: Any, rate_hz: float) -> Any:
            def call(*arguments: Any) -> None:
                if monitor.parameters.alarm_rate_hz == rate_hz:
                    raise ValueError(f"as {rate_hz:g} asks for")
                method(*arguments)

            return call

        monitor._judge_completed = failing(monitor._judge_completed, MONITOR_FAILS_HZ)
        estimator._take_pose = failing(estimator._take_pose, ESTIMATOR_FAILS_HZ)
        serve([estimator, monitor])

    return run(work)


if __name__ == "__main__":
    raise SystemExit(main())
