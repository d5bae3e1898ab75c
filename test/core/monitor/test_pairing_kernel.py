# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Arrivals taken in stretches are those taken one by one."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.monitor.pairing import Pairing
from quadpi_core.monitor.pairing_kernel import IMU, ROTORS, STATE, Arriving
from test.core.monitor.test_pairing import LEVEL, MS, add_imu, add_rotors, add_state, taken


@pytest.mark.parametrize("state_first", [True, False])
def test_what_is_used_first_does_not_depend_on_which_topic_arrives_first(state_first: bool) -> None:
    """States at 100 Hz complete five IMU samples at once, in the instant at which the rate is known too."""
    imu_ns, state_ns = np.arange(600) * 2 * MS, np.arange(0, 600, 5) * 2 * MS
    after_imu = np.concatenate((np.zeros(600), np.full(120, -0.5 if state_first else 0.5)))
    order = np.argsort(np.concatenate((imu_ns, state_ns)) + after_imu, kind="stable")
    kinds, rows = np.repeat([IMU, STATE], [600, 120])[order], np.r_[:600, :120][order]
    states = np.tile(np.concatenate((np.zeros(3), LEVEL, np.zeros(3))), (120, 1))
    arriving = Arriving(
        kind=np.concatenate(([ROTORS, ROTORS], kinds)),
        row=np.concatenate(([0, 1], rows)),
        imu_ns=imu_ns,
        specific_force=np.zeros((600, 3)),
        state_ns=state_ns,
        states=states,
        rotor_ns=np.array([0, 2000 * MS]),
        rotor_speeds=np.full((2, 4), 300.0),
        wind_ns=np.empty(0, dtype=np.int64),
        wind=np.empty((0, 3)),
    )
    used = [part.samples.time_ns for part in Pairing().take_all(arriving) if not part.rate.begins]
    assert np.concatenate(used)[0] == 1000 * MS

    live = Pairing()
    live_ns: list[int] = []
    for kind, row in zip(kinds.tolist(), rows.tolist(), strict=True):
        if row == kind == 0:
            add_rotors(live, 0)
            add_rotors(live, 2000 * MS)
        if kind == IMU:
            add_imu(live, int(imu_ns[row]))
        else:
            add_state(live, int(state_ns[row]))
        samples = taken(live)
        live_ns += [] if live.rate.begins else samples
    np.testing.assert_array_equal(live_ns, np.concatenate(used))
