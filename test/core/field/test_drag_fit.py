# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Wind, fitted together with drag."""

from __future__ import annotations

from .field_examples import example
from .test_drag import identified
from .windy_flights import windy_flight


def test_a_constant_heading_leaves_the_wind_to_the_bias():
    (winds,) = identified(example()).wind
    assert all("the nose to all sides" in one.reason for one in winds)


def test_each_wind_of_many_flights_is_told_by_its_own_flight(tmp_path):
    """Without all that tells of a wind, what was known before would stand for it, and its error for ours."""
    flights = [windy_flight(tmp_path, seed) for seed in range(100, 105)]
    together = identified(*(one.log for one in flights))
    assert together.by_flight
    for one, winds in zip(flights, together.wind, strict=True):
        alone = identified(one.log).wind[0]
        for axis in range(2):
            assert winds[axis].low <= one.wind[axis] <= winds[axis].high
            assert winds[axis].half_width < 2.0 * alone[axis].half_width
