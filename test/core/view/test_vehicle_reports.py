# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What battery and autopilot say beside the state, in words."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.view.trust import REPORTS


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"voltage": 15.24, "percentage": 0.78}, "15.2 V, 78 %"),
        ({"voltage": 15.24, "percentage": np.nan}, "15.2 V"),
        ({"voltage": np.nan, "percentage": 0.78}, "78 %"),
        ({"voltage": np.nan, "percentage": np.nan}, "not measured"),
    ],
)
def test_a_battery_says_what_it_measures(given, words):
    assert REPORTS["sensor_msgs/msg/BatteryState"].words(given) == words


@pytest.mark.parametrize("mode", ["OFFBOARD", b"OFFBOARD"])
def test_an_autopilot_says_its_mode_and_whether_it_is_connected(mode):
    words = REPORTS["mavros_msgs/msg/State"].words({"connected": False, "armed": True, "mode": mode})
    assert words == "OFFBOARD, armed, link lost"
