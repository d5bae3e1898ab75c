# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The estimate on /tf, slower than the IMU: every listener of a machine takes every transform."""

from __future__ import annotations

from typing import Any

from quadpi_core.frames import Array
from quadpi_core.messages.frame_ids import TF_TYPE
from quadpi_core.messages.transform_messages import transform_message
from quadpi_ros.input_sources import AdapterError, message_class
from quadpi_ros.node_parameters import EstimatorParameters
from quadpi_ros.parameters import ParameterError
from quadpi_ros.sensor_node import SensorNode

# In no namespace, as tf2 has it: frames carry the vehicle's.
TOPIC = "/tf"


class TransformPublisher:
    """Publishes the transform from the world to the body.

    Args:
        node: to publish from; its parameters name the frames and the rate, which is not 0.

    Raises:
        ParameterError: if the package of the messages is not installed.
    """

    def __init__(self, node: SensorNode[EstimatorParameters]) -> None:
        given = node.parameters
        try:
            message_type: Any = message_class(TF_TYPE)
        except AdapterError as error:
            raise ParameterError(f"node {node.get_name()}: parameter `tf_rate_hz`: {error}") from error
        self._period_ns = round(1e9 / given.tf_rate_hz)
        self._period = -1
        self._message = transform_message(given.world_frame, given.body_frame)
        self._publish = node.announce(message_type, TOPIC)

    def publish(self, time_ns: int, pose: Array) -> None:
        """Publish a pose (1, 7), see :func:`transform_message`, if it is the first of its period."""
        period = time_ns // self._period_ns
        if period != self._period:
            self._period = period
            self._message.values[:] = pose
            self._publish(self._message.stamped(time_ns))
