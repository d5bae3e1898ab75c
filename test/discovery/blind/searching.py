# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One case searched: the search gets flights and the simulation of the vehicle's file, nothing else."""

from __future__ import annotations

import time
from functools import lru_cache
from typing import Any

from blind.cases import VEHICLE, Case
from quadpi_core.discrepancy import VehicleSimulation, discover
from quadpi_core.errors import one_line


@lru_cache
def _simulation() -> VehicleSimulation:
    return VehicleSimulation.load(VEHICLE)


def searched(shared: None, case: Case) -> dict[str, Any]:  # noqa: ARG001
    """What the search says of a case, as JSON can hold it, beside the seal."""
    flights = case.flights()
    began = time.perf_counter()
    try:
        result = discover(_simulation(), flights, seed=0).as_dict()
    except Exception as error:
        # Whatever a search raises on possible flights is a failure to list, not the end of the run.
        result = {
            "verdict": f"error: {one_line(error)}",
            "effects": [],
            "ambiguous": [],
            "gap": {"reduction": None},
        }
    return {"seal": case.seal, "seconds": time.perf_counter() - began, "result": result}
