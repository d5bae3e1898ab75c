# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where simulation and measurement disagree: find it, name the missing effect, add it, show the gap shrink.

A flight beside a simulation (`contributions`, `simulations`) leaves a residual. Candidates (`candidates`)
are effects of the simulation's registry. Their columns stand with what the simulation is uncertain in
(`design`), white among frequencies (`whitening`); evidence chooses (`evidence`, `search`), functions that
know no physics tell what is left (`generic`), and flights left out in turn show the gap (`gap`).
"""

from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.callable_simulation import CallableSimulation
from quadpi_core.discrepancy.discovery import discover
from quadpi_core.discrepancy.discrepancy_result import Discovery, FoundEffect, FoundParameter
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.simulations import Simulation, Tolerances, VehicleSimulation

__all__ = [
    "AugmentedSimulation",
    "CallableSimulation",
    "Discovery",
    "FoundEffect",
    "FoundParameter",
    "Simulation",
    "Tolerances",
    "VehicleSimulation",
    "discover",
    "load_simulation",
]
