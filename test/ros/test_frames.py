# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages in other frames over real DDS: what the nodes refuse, and why."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("quadpi.msg", reason="the quadpi messages are not built")

from diagnostic_msgs.msg import DiagnosticStatus

from quadpi_core.flight import ImuStream, PoseStream, Recording
from quadpi_core.logs import messages
from quadpi_ros.processes import Child

from .rig import Rig, arguments, values_of

pytestmark = pytest.mark.usefixtures("ros_domain")

LEVEL = np.array([[1.0, 0.0, 0.0, 0.0]])


def test_other_frames_are_refused_with_their_reason(folder: Path, hover: Recording, tmp_path: Path) -> None:
    strict = (*arguments(str(folder / "model")), "-p", "frames:=strict")
    with Child("quadpi_ros.live", strict, tmp_path) as nodes:
        rig = Rig(hover)
        try:
            rig.listen()
            for k in range(10):
                stamp = np.array([rig.now_ns + 2_000_000 * k])
                imu = ImuStream(stamp, np.zeros((1, 3)), np.array([[0.0, 0.0, -9.81]]))
                rig._send("imu", messages.pack_imu(imu, "imu_link"))
                pose = PoseStream(stamp, np.zeros((1, 3)), LEVEL)
                rig._send("mocap/pose", messages.pack_pose(pose, "world_ned"))
            for topic, reason in (
                ("imu", "the frame `imu_link` is not the body's, `base_link`, and no static transform"),
                ("mocap/pose", "the frame `world_ned` says north-east-down: east-north-up is expected"),
            ):
                status = rig.await_status(f"estimator: {topic}", DiagnosticStatus.WARN, "samples refused")
                assert any(reason in key for key in values_of(status))
        finally:
            rig.close()
        assert not nodes.finished()
