# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The live nodes, with errors in the program: `python failing_live.py --ros-args …`.

While the node `monitor` has an alarm_rate_hz of 123, what it does with every sample raises an exception; at
321 Hz, what the estimator does with every pose.
"""

from __future__ import annotations

from typing import Any

from quadpi_core.estimator.ekf import Ekf
from quadpi_core.monitor.pairing import Pairing
from quadpi_ros.live_process import create_nodes
from quadpi_ros.runtime import run, serve

MONITOR_FAILS_HZ, ESTIMATOR_FAILS_HZ = 123.0, 321.0


def main() -> int:
    """Run the process."""

    def work() -> None:
        estimator, monitor = create_nodes()

        def fail(owner: type, name: str, rate_hz: float) -> None:
            method = getattr(owner, name)

            def call(*arguments: Any) -> Any:
                if monitor.parameters.alarm_rate_hz == rate_hz:
                    raise ValueError(f"as {rate_hz:g} asks for")
                return method(*arguments)

            setattr(owner, name, call)

        fail(Pairing, "take", MONITOR_FAILS_HZ)
        fail(Ekf, "update_pose", ESTIMATOR_FAILS_HZ)
        serve([estimator, monitor])

    return run(work)


if __name__ == "__main__":
    raise SystemExit(main())
