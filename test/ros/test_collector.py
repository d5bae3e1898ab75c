# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is told of the alarm while it comes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from quadpi_core.results import ReportedAlarms
from quadpi_ros.collector import AlarmFollower


def test_alarm_follower_tells_changes_from_repetition() -> None:
    def alarm(time_s: float, level: int, *inputs: str) -> Any:
        return SimpleNamespace(
            time_ns=[round(time_s * 1e9)],
            level=[level],
            causes=[1 if level else 0],
            inputs_outside=[inputs],
            envelope_distance=[0.1],
        )

    follower = AlarmFollower(start_ns=0)
    rows: list[ReportedAlarms] = [
        alarm(0.0, 0),
        alarm(0.1, 1, "u"),
        alarm(0.2, 2, "u"),
        alarm(0.3, 2, "u"),
        alarm(0.4, 2, "p", "u"),
        alarm(0.5, 2, "p"),
        alarm(0.6, 0),
        alarm(0.7, 0, "u"),
    ]
    changes = [follower.follow(row) for row in rows]
    assert [change is not None for change in changes] == [False, True, True, False, True, False, True, False]
    assert changes[4].time_s == pytest.approx(0.4)
    assert changes[4].inputs_outside == ("p", "u")
