# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Predictions as standard wrenches: which topics there are, and what goes out on each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import WrenchStamped
from quadpi.msg import WrenchPrediction
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.serialization import deserialize_message

from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_ros.monitor_node import MonitorNode
from quadpi_ros.result_publishers import Results, named
from quadpi_ros.wrench_publisher import TOPICS

from .rig import values_of_wrench
from .test_result_publishers import Outputs, hover, monitor_of

COUNT = 50


def test_wrenches_are_those_of_the_predictions(folder: Path) -> None:
    """Of the first model by their names, of another one below these; read as any tool reads them."""
    models = [AerodynamicModel.load(folder / name) for name in ("model", "other")]
    outputs = Outputs()
    results = Results(outputs, named(map(monitor_of, models)), "uav/base_link", wrenches=True)  # type: ignore[arg-type]
    results.publish(hover(COUNT))
    for prediction, below in (("prediction", ""), ("/uav/prediction/other", "other")):
        predictions = [deserialize_message(one, WrenchPrediction) for one in outputs.sent[prediction]]
        assert len(predictions) == COUNT
        names = {name: f"/uav/{topic}/{below}" if below else topic for name, topic in TOPICS.items()}
        sent = {
            name: [deserialize_message(one, WrenchStamped) for one in outputs.sent[topic]]
            for name, topic in names.items()
        }
        for k, prediction_k in enumerate(predictions):
            found = {name: values_of_wrench(messages[k].wrench) for name, messages in sent.items()}
            assert all(messages[k].header == prediction_k.header for messages in sent.values())
            np.testing.assert_array_equal(found["predicted"], values_of_wrench(prediction_k.predicted))
            np.testing.assert_array_equal(found["measured"], values_of_wrench(prediction_k.measured))
            np.testing.assert_array_equal(found["residual"], found["measured"] - found["predicted"])
        assert np.abs(found["residual"]).max() > 0.0


@contextmanager
def configured(domain: int, folder: Path, *given: str) -> Iterator[MonitorNode]:
    model = f"model:=[{folder / 'model'}, {folder / 'other'}]"
    arguments = ["-p", "vehicle:=neurobem", "-p", model, "-r", "__ns:=/uav", *given]
    rclpy.init(args=["--ros-args", *arguments], domain_id=domain)
    try:
        node = MonitorNode()
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        yield node
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


@pytest.mark.parametrize(
    ("given", "topics"),
    [
        ((), set()),
        (
            ("-p", "publish_wrenches:=true", "-r", "wrench/residual:=/lab/gap"),
            {
                *("/uav/wrench/predicted", "/uav/wrench/measured", "/lab/gap"),
                *("/uav/wrench/predicted/other", "/uav/wrench/measured/other", "/lab/gap/other"),
            },
        ),
    ],
)
def test_wrenches_are_published_where_the_parameter_says_so(
    ros_domain: int, folder: Path, given: tuple[str, ...], topics: set[str]
) -> None:
    with configured(ros_domain, folder, *given) as node:
        found = {one.topic_name for one in node.publishers if one.msg_type is WrenchStamped}
    assert found == topics
