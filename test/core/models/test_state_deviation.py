# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How unsure the states of a model's flights were: the median flight, never less than motion capture."""

from __future__ import annotations

import pytest

from quadpi_core.models.interval_rules import SETTLED, StateDeviation


def test_the_median_flight_counts_and_motion_capture_is_the_least():
    found = StateDeviation.of_flights([(0.08, 0.001), (0.09, 0.002), (0.5, 0.003)])
    assert found.velocity_m_s == pytest.approx(0.09)
    assert found.attitude_rad == SETTLED.attitude_rad
    assert StateDeviation.of_flights([(0.001, 0.001)]) == SETTLED
