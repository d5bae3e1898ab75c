# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One case searched: the search gets flights and a simulation; checked on flights it never saw."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from blind.cases import Case, noise_alone
from quadpi_core.discrepancy.augmented_simulation import augmented
from quadpi_core.discrepancy.discrepancy_result import Rollouts, discovery_json
from quadpi_core.discrepancy.reflight import rollout, rollout_floor, rollouts
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.discrepancy.study import found_and_flown
from quadpi_core.errors import one_line
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.signals.wrench import measured_wrench


def searched(shared: None, case: Case) -> dict[str, Any]:  # noqa: ARG001
    """What the search says of a case, as JSON can hold it, beside the seal."""
    flights, simulation, checks = case.flights(), case.simulation(), case.checks()
    began = time.perf_counter()
    left, flown, seconds = None, None, None
    try:
        discovery = found_and_flown(simulation, flights)
        result, seconds = discovery_json(discovery), time.perf_counter() - began
        if discovery.added and checks:
            added = augmented(discovery)
            left = gap_left(simulation, added, checks, _floor())
            flown = rollout_changes(rolled_out(checks, simulation, added))
    except Exception as error:
        # Whatever is raised on possible flights is a failure to list, not the end of the run.
        result = {"verdict": f"error: {one_line(error)}", "effects": [], "ambiguous": []}
        left, flown = None, None
    seconds = seconds or time.perf_counter() - began
    return {"seal": case.seal, "seconds": seconds, "left": left, "rollouts": flown, "result": result}


def rolled_out(flights: Sequence[Flight], before: Simulation, after: Simulation) -> Rollouts:
    """Roll-outs of flights by a simulation and by one with what was added."""
    squares = [[rollout(flight, own) for flight in flights] for own in (before, after)]
    return rollouts(*squares, [rollout_floor(flight, after.vehicle) for flight in flights])


def rollout_changes(flown: Rollouts) -> dict[str, tuple[float, float]]:
    """Errors of roll-outs without and with what was added, by quantity, and how many diverge."""
    errors = {name: (error.before, error.after) for name, error in flown.errors.items()}
    return {**errors, "lost": (flown.lost["before"], flown.lost["after"])}


def gap_left(before: Simulation, after: Simulation, flights: Sequence[Flight], floor: Array) -> float:
    """Share of the removable gap that an augmented simulation leaves, squares in units of the noise's.

    Args:
        before: the simulation.
        after: with what was found.
        flights: of no part in the search.
        floor: (6,) mean squares of the noise.
    """
    was, left = (np.sum(mean_squares(s, flights) / floor - 1.0) for s in (before, after))
    return float(left / was)


def mean_squares(simulation: Simulation, flights: Sequence[Flight]) -> Array:
    """Of measured less simulated wrench (6,)."""
    residuals = [
        measured_wrench(flight, simulation.vehicle) - simulation.wrench(flight) for flight in flights
    ]
    squares: Array = np.square(np.vstack(residuals)).mean(axis=0)
    return squares


@lru_cache
def _floor() -> Array:
    flights, simulation = noise_alone()
    return mean_squares(simulation, flights)
