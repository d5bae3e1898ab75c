# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled functions as arguments of kernels."""

from __future__ import annotations

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.simulation.state_records import STATE, VEHICLE
from quadpi_core.simulation.wrench_functions import apply_to_all, passable


@njit
def _push(state, vehicle, parameters):
    state.wrench[0] += parameters[0, 0] * state.rates[0] * vehicle.mass


def test_a_function_is_called_for_every_state():
    states, vehicle = np.zeros(3, STATE), np.zeros(1, VEHICLE)
    states["rates"][:, 0], vehicle["mass"] = [1.0, 2.0, 3.0], 2.0
    apply_to_all(states, vehicle, passable(_push), np.array([[0.5]]))
    np.testing.assert_array_equal(states["wrench"][:, 0], [1.0, 2.0, 3.0])
    assert passable(_push) is passable(_push)
