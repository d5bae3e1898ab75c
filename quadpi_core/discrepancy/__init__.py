# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where simulation and measurement disagree: find it, name the missing effect, add it, show the gap shrink.

1. A flight compared with a simulation leaves a residual (`simulations`, `effect_response`).
2. Candidates are the effects of the simulation's registry (`candidates`). With what the simulation is
   uncertain in, they become columns in frequency, where noise is white within bands (`linearisation`,
   `whitening`).
3. The evidence of sets of effects (`effect_regression`, `evidence`) and a list of named tests (`trial`,
   `acceptance`) choose (`search`).
4. Functions that know no physics show what is left without a name (`unexplained`).
5. Flights left out in turn show how far the gap closes (`closure`), where it was (`by_condition`), and how
   the simulation with the effects flies (`augmented_simulation`, `reflight`).
"""

from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.discrepancy_result import Discovery, FoundEffect, FoundParameter
from quadpi_core.discrepancy.external_simulations import CallableSimulation
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.simulations import Simulation, Tolerances, VehicleSimulation
from quadpi_core.discrepancy.study import discover

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
