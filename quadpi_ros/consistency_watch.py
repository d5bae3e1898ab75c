# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The consistency check of a node: in its first seconds of flight, in a thread, into log and diagnostics."""

from __future__ import annotations

import threading
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from quadpi_core.flight import Recording, Stream
from quadpi_core.screening.first_seconds import STRETCHES, FirstSeconds, contradictions
from quadpi_core.vehicle import Vehicle
from quadpi_ros import diagnostics
from quadpi_ros.sensor_node import SensorNode


class ConsistencyWatch:
    """Looks for mistakes in frames, units, clocks and vehicle while the node goes on.

    Args:
        node: whose samples they are.
        vehicle: whose rotor speeds are among the samples; without one only the motion is looked at.
    """

    def __init__(self, node: SensorNode[Any], vehicle: Vehicle | None) -> None:
        self._node = node
        self._vehicle = vehicle
        self._samples = FirstSeconds(node.get_name())
        self._found: dict[str, None] = {}
        self._judged = 0

    @property
    def complete(self) -> bool:
        """Whether no more samples are needed."""
        return self._samples.complete

    def take(self, *streams: Stream) -> None:
        """Take samples; those of the IMU last, as they complete a stretch."""
        stretch = self._samples.take(*streams)
        if stretch is not None:
            work = self._node.guard("consistency check", self._judge)
            threading.Thread(target=work, args=(stretch,), name="consistency", daemon=True).start()

    def _judge(self, stretch: Recording) -> None:
        for problem in contradictions(stretch, self._vehicle):
            self._found[problem] = None
            self._node.get_logger().warning(f"consistency: {problem}")
        self._judged += 1

    def status(self) -> DiagnosticStatus:
        """What `/diagnostics` says: every contradiction that was found since the node became active."""
        found, judged = list(self._found), self._judged
        level, message = diagnostics.OK, "sensors and vehicle agree"
        if found:
            level, message = diagnostics.WARN, "; ".join(found)
        elif judged == 0:
            message = "not judged yet: it takes some seconds of motion"
        values = {"stretches": f"{judged} of {STRETCHES}"}
        return self._node.status("consistency", level, message, values)
