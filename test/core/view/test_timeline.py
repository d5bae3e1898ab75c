# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A session of any length at a glance."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.view.blocks import BINS, FIRST_BIN_S, POINTS, Timeline, Track
from quadpi_core.view.trust import State


def test_the_worst_state_of_a_bin_is_shown():
    line = Timeline()
    states = [State.TRUSTED, State.ALARM, State.WARNING, State.NOT_JUDGED, State.NO_DATA, State.TRUSTED]
    line.add(FIRST_BIN_S * np.array([0.1, 0.2, 0.3, 2.1, 2.2, 2.3]), np.array(states, dtype=np.uint8))
    assert line.codes == f"{State.ALARM}-{State.NO_DATA}"


@pytest.mark.parametrize("hours", [0.05, 1.0, 24.0])
def test_an_alarm_of_a_moment_is_seen_after_any_time_in_bounded_room(hours):
    line = Timeline()
    time_s = np.arange(0.0, 3600.0 * hours, 1.0)
    states = np.full(len(time_s), int(State.TRUSTED), dtype=np.uint8)
    states[len(states) // 3] = State.ALARM
    line.add(time_s, states)
    assert len(line.codes) <= BINS
    assert line.codes.count(str(int(State.ALARM))) == 1
    place = line.codes.index(str(int(State.ALARM)))
    assert place * line.bin_s <= time_s[len(states) // 3] < (place + 1) * line.bin_s


def test_the_track_spans_the_session_with_bounded_points():
    track = Track()
    for start in range(0, 7200, 10):
        time_s = start + np.arange(0.0, 10.0, 0.002)
        track.add(time_s, np.stack((time_s, 0 * time_s, -time_s), axis=1))
    points = np.array(track.points)
    assert POINTS / 3 < len(points) < POINTS
    assert points[0, 0] == 0.0
    assert points[-1, 0] > 7180.0
    np.testing.assert_allclose(points[:, 1], points[:, 0], atol=0.02)
    assert np.diff(points[:, 0]).min() > 1.0
