# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the results of one model, and of several."""

from __future__ import annotations

from pathlib import Path

import pytest
import rclpy
from rclpy.lifecycle import TransitionCallbackReturn

from quadpi_ros.monitor_node import MonitorNode

pytestmark = pytest.mark.usefixtures("ros_domain")


@pytest.mark.parametrize(
    ("remapping", "prediction"),
    [("prediction:=/lab/wrench", "/lab/wrench"), ("imu:=/lab/imu", "/uav/prediction")],
)
def test_predictions_of_all_models_go_by_the_other_name(
    remapping: str, prediction: str, ros_domain: int, folder: Path
) -> None:
    model = f"model:=[{folder / 'model'}, {folder / 'other'}]"
    given = ["-p", "vehicle:=neurobem", "-p", model, "-r", "__ns:=/uav", "-r", remapping]
    rclpy.init(args=["--ros-args", *given], domain_id=ros_domain)
    try:
        node = MonitorNode()
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        topics = {publisher.topic_name for publisher in node.publishers}
        assert topics >= {prediction, f"{prediction}/other"}
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
