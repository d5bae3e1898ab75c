# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is to be done once per period is done in a flood of messages too."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import pytest
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import Imu

from quadpi_core.flight import ImuStream
from quadpi_core.messages import sensor_messages
from quadpi_ros.node_parameters import parameter
from quadpi_ros.runtime import start
from quadpi_ros.sensor_node import SensorNode

from .rig import wait_until


@dataclass(frozen=True)
class Parameters:
    autostart: bool = parameter(False, "as the nodes have it")


@pytest.mark.usefixtures("ros")
def test_what_is_watched_is_done_where_more_messages_come_than_can_be_taken() -> None:
    """The executor takes events in their order: a timer alone would wait behind ever more messages."""
    taken, done, enough = [], [], threading.Event()

    class Busy(SensorNode[Parameters]):
        def activate(self) -> None:
            self.listen(Imu, "imu", sensor_messages.unpack_imu, self.take)
            self.watch(0.1, lambda: done.append(len(taken)))

        def take(self, imu: ImuStream) -> None:
            taken.append(imu)
            enough.wait(0.01)

    node, driver = Busy("busy", Parameters), Node("driver")
    imu = driver.create_publisher(Imu, "imu", 10)
    executor = EventsExecutor()
    executor.add_node(node)
    start([node])
    node.must(node.trigger_configure)
    node.must(node.trigger_activate)
    wait_until(lambda: imu.get_subscription_count() > 0)

    def flood() -> None:
        while not enough.wait(0.002):
            imu.publish(Imu())

    def spin() -> None:
        while not enough.is_set():
            executor.spin_until_future_complete(Future(), timeout_sec=0.1)

    threads = [threading.Thread(target=work, daemon=True) for work in (flood, spin)]
    for thread in threads:
        thread.start()
    try:
        wait_until(lambda: len(taken) > 300 or len(done) > 10)
    finally:
        enough.set()
        for thread in threads:
            thread.join()
        executor.shutdown()
    assert len(done) > 10
    for one in (node, driver):
        one.destroy_node()
