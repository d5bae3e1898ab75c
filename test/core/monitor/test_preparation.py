# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From paired samples to inputs and measured wrench, against scipy and the equations themselves."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.monitor.preparation import SETTLE_NS, Preparation
from test.core.monitor.conftest import RATE_HZ
from test.core.monitor.test_monitor import changed

SETTLE_S = 1e-9 * SETTLE_NS


@pytest.mark.parametrize(("missing_s", "anew"), [(0.08, False), (0.2, True)])
def test_a_state_settles_after_its_start_and_after_an_interruption(vehicle, samples, missing_s, anew):
    seconds = 1e-9 * (samples.time_ns - samples.time_ns[0])
    velocity, attitude = samples.velocity.copy(), samples.attitude.copy()
    missing = (seconds >= 4.0) & (seconds < 4.0 + missing_s)
    velocity[missing], attitude[missing] = np.nan, np.nan
    prepared = Preparation(vehicle, RATE_HZ, 20.0).step(
        *changed(samples, velocity=velocity, attitude=attitude)
    )
    used = seconds[prepared.usable]
    expected = used >= SETTLE_S
    if anew:
        expected &= (used < 4.0) | (used >= 4.0 + missing_s + SETTLE_S)
    np.testing.assert_array_equal(prepared.usable, ~missing)
    np.testing.assert_array_equal(prepared.settled, expected)
