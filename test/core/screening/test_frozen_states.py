# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Motion capture that repeats its pose in flight is named, with the time; parked it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.screening.motion_consistency import without_repeats
from test.core.mistakes import frozen


def test_a_pose_that_repeats_in_flight_is_named_with_the_time_and_left_out(flown) -> None:
    recording, _ = frozen(1.5)(flown["train_2"], None)
    moving, finding = without_repeats(recording.pose, recording.imu)
    assert finding is not None
    assert finding.text.startswith("position and attitude repeat from 10.")
    assert "and so for 1.5 s in all" in finding.text
    steps = np.diff(moving.time_ns) * 1e-9
    assert 1.4 < steps.max() < 1.6
    assert np.sort(steps)[-2] < 0.25


def test_nothing_is_said_of_a_pose_that_repeats_while_parked(flown) -> None:
    recording, _ = frozen(1.5)(flown["train_2"], None)
    imu = replace(recording.imu, angular_velocity=np.full((len(recording.imu), 3), 0.02))
    assert without_repeats(recording.pose, imu) == (recording.pose, None)
