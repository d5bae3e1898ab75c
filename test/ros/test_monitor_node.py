# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors that never came, begin and stop, over real DDS: what alarm and diagnostics say meanwhile."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from quadpi_core.flight import Recording
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.result_messages import unpack_alarms
from quadpi_core.results import BAD_DATA, LEVEL_ALARM, ReportedAlarms
from quadpi_ros.live_session import Child

from .rig import STARTED_S, Rig, arguments, assert_alive

pytestmark = pytest.mark.usefixtures("ros_domain")

FILTER, ALARM, PAIRING = "estimator: filter", "monitor: alarm", "monitor: pairing"


def heard(rig: Rig) -> ReportedAlarms:
    return unpack_alarms(Payloads.join(rig.heard["extrapolation_alarm"]))


def assert_stale(rig: Rig, *parts: str) -> None:
    for name, part in zip((FILTER, ALARM, PAIRING), parts, strict=True):
        rig.await_status(name, DiagnosticStatus.STALE, part)


def test_silence_is_said(folder: Path, hover: Recording, tmp_path: Path) -> None:
    with (
        Child("quadpi_ros.live_process", arguments(str(folder / "model")), tmp_path) as nodes,
        Rig(hover, nodes) as rig,
    ):
        rig.until(lambda: len(rig.heard["extrapolation_alarm"]) > 3)
        assert heard(rig).reasons[-1] == ("no imu yet", "no rotor speeds yet")
        assert_stale(rig, "nothing arrives on imu", "no imu yet", "no imu yet")
        rig.forget()

        _, last_ns = rig.fly(STARTED_S + 1.5)
        rig.await_stamp("prediction", last_ns)
        told = [status.message for status in list(rig.told) if status.level == DiagnosticStatus.ERROR]
        assert not any("clock" in message for message in told)
        rig.forget()

        rig.until(lambda: len(rig.heard["extrapolation_alarm"]) > 5)
        alarms = heard(rig)
        silent = alarms.where(~alarms.of_samples)
        assert (silent.level == LEVEL_ALARM).all()
        assert (silent.causes & BAD_DATA).all()
        assert silent.reasons[0][0].startswith("no imu for 0.")
        assert (np.diff(silent.time_ns) > 50_000_000).all()
        assert 0 < silent.time_ns[0] - last_ns < 2_000_000_000
        assert_stale(rig, "nothing arrives on imu", "no imu for", "no imu for")

        rig.now_ns += 10_000_000_000
        first_ns, last_ns = rig.fly(STARTED_S + 1.0)
        rig.await_stamp("prediction", last_ns)
        alarms = heard(rig)
        again = alarms.where((alarms.time_ns > first_ns + 10**9) & (alarms.time_ns <= last_ns))
        assert again.of_samples.all()

        before_ns = np.array([last_ns])
        rig.forget()
        rig.fly(
            4.0, lambda _, sample: sample | {"mocap/pose": replace(sample["mocap/pose"], time_ns=before_ns)}
        )
        texts = {text for words in heard(rig).reasons for text in words}
        assert any(re.fullmatch(r"no motion capture for \d\.\d s", text) for text in texts), texts
        assert not any(text.startswith(("state missing", "no state")) for text in texts)

        def of_another_clock(_: int, sample: dict[str, Any]) -> dict[str, Any]:
            pose = sample["mocap/pose"]
            return sample | {"mocap/pose": replace(pose, time_ns=pose.time_ns + 100 * 10**9)}

        assert "clock" not in "".join(path.read_text() for path in tmp_path.iterdir())
        rig.now_ns += 10_000_000_000
        rig.fly(2.5, of_another_clock)
        apart = "imu and mocap/pose are stamped 100 s apart: by different clocks?"
        rig.await_status("estimator: state", DiagnosticStatus.ERROR, apart)
        assert_alive(nodes)


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
        wrong, not_judged = alarms.reasons[-1]
        assert wrong == "imu rate is not imu_rate_hz"
        assert not_judged.startswith("not judged: no usable samples")
        assert rig.heard["odometry"]
        assert not rig.heard["prediction"]
        assert_alive(nodes)
    assert told in "".join(path.read_text() for path in tmp_path.iterdir())
