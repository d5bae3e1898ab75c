# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Streams of a recording: what is refused, and how they are cut and joined."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import Recording


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda t: t + 3 * 86_400_000_000_000 * (t > t[50]),
            r"sample 51: comes 3\.0 days after the one before",
        ),
        (lambda t: t + 2**31 * 1_000_000_000, "sample 0: the stamp is before 1970 or after 2038"),
        (lambda t: t - 1, "sample 0: the stamp is before 1970 or after 2038"),
    ],
)
def test_stamps_that_no_flight_has_are_refused(hover: Recording, change: Callable, message: str):
    wrong = replace(hover, imu=replace(hover.imu, time_ns=change(hover.imu.time_ns)))
    with pytest.raises(LogError, match=rf"hover\.mcap: topic imu: {message}"):
        wrong.check()


def test_values_beyond_any_flight_are_refused(hover: Recording):
    position = hover.pose.position.copy()
    position[7, 1] = -2e6
    wrong = replace(hover, pose=replace(hover.pose, position=position))
    with pytest.raises(
        LogError, match=r"topic mocap/pose: sample 7: position holds -2e\+06; nothing in a flight"
    ):
        wrong.check()
