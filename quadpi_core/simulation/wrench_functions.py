# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled functions that add a wrench to a state, in the form in which kernels take them as arguments."""

from __future__ import annotations

import warnings
from typing import Any, cast

from numba import NumbaExperimentalFeatureWarning, types

from quadpi_core.compiled import njit, once
from quadpi_core.frames import Array
from quadpi_core.records import Records
from quadpi_core.simulation.state_records import STATE_TYPE, VEHICLE_TYPE

# Signature of such a function: (state, vehicle, parameters (K, P)).
SIGNATURE = types.void(STATE_TYPE, VEHICLE_TYPE, types.float64[:, ::1])
FUNCTION_TYPE = types.FunctionType(SIGNATURE)

# Numba has called functions as arguments of kernels experimental since 2020.
warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)


@once
def passable(function: Any) -> Any:
    """A compiled function as numba accepts it as an argument: for one signature, and closed for others."""
    function.compile(SIGNATURE)
    function.disable_compile()
    return function


@once
def _kernel_for_all() -> Any:
    kernel = cast(Any, _apply_to_all)
    kernel.compile(types.void(STATE_TYPE[::1], VEHICLE_TYPE[::1], FUNCTION_TYPE, types.float64[:, ::1]))
    kernel.disable_compile()
    return kernel


def apply_to_all(states: Records, vehicle: Records, function: Any, parameters: Array) -> None:
    """Call a :func:`passable` function for each of the records STATE (N,), with a record VEHICLE (1,)."""
    _kernel_for_all()(states, vehicle, function, parameters)


@njit(cache=True, nogil=True)
def _apply_to_all(states: Records, vehicles: Records, function: Any, parameters: Array) -> None:
    for i in range(len(states)):
        function(states[i], vehicles[0], parameters)
