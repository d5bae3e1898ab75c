# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A wrong `imu_rate_hz` over real DDS: nothing is predicted, and all that speaks says why."""

from __future__ import annotations

from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from quadpi_core.flight import Recording
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.result_messages import unpack_alarms
from quadpi_core.results import BAD_DATA, LEVEL_ALARM
from quadpi_ros.processes import Child

from .rig import STARTED_S, Rig, arguments, assert_alive

pytestmark = pytest.mark.usefixtures("ros_domain")


def test_a_rate_that_is_given_wrong_predicts_nothing(folder: Path, hover: Recording, tmp_path: Path) -> None:
    given = (*arguments(str(folder / "model")), "-p", "imu_rate_hz:=400.0")
    with Child("quadpi_ros.live_process", given, tmp_path) as nodes, Rig(hover, nodes) as rig:
        rig.fly(STARTED_S + 1.2)
        told = "stamps say 500 Hz, imu_rate_hz is 400"
        rig.await_status("estimator: imu", DiagnosticStatus.ERROR, told)
        rig.await_status("monitor: pairing", DiagnosticStatus.ERROR, told)
        alarms = unpack_alarms(Payloads.join(rig.heard["extrapolation_alarm"]))
        assert alarms.level[-1] == LEVEL_ALARM
        assert alarms.causes[-1] == BAD_DATA
        assert alarms.reasons[-1] == ("imu rate is not imu_rate_hz",)
        assert rig.heard["odometry"]
        assert not rig.heard["prediction"]
        assert_alive(nodes)
    assert told in "".join(path.read_text() for path in tmp_path.iterdir())
