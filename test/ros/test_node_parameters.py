# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of all nodes agree with the files, the core and the readers that they describe."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import yaml

from quadpi_core.logs.mavlink_samples import SOURCES
from quadpi_core.monitor import MonitorSettings
from quadpi_ros.parameters import MAVLINK_IMU_MESSAGES, EstimatorParameters, MonitorParameters

ROOT = Path(__file__).parents[2]


NODES = {"estimator": EstimatorParameters, "monitor": MonitorParameters}


# Set by the launch file from its arguments.
FROM_LAUNCH = {"vehicle", "model"}


def test_parameter_file_and_nodes_agree() -> None:
    file = yaml.safe_load((ROOT / "config" / "nodes" / "monitor.yaml").read_text())
    assert file.keys() == {f"/**/{name}" for name in NODES}
    for name, parameters in NODES.items():
        defaults = {item.name: item.default for item in fields(parameters) if item.name not in FROM_LAUNCH}
        assert file[f"/**/{name}"]["ros__parameters"] == defaults


def test_alarm_defaults_are_those_of_the_core() -> None:
    settings = MonitorSettings()
    defaults = {item.name: item.default for item in fields(MonitorParameters)}
    for item in fields(MonitorSettings):
        assert defaults[item.name] == getattr(settings, item.name)


def test_the_bridge_takes_every_imu_message_that_it_can_read() -> None:
    assert SOURCES["imu"] == MAVLINK_IMU_MESSAGES
