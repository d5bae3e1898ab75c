# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What flights are compared with, one file per kind of simulation."""

from quadpi_core.discrepancy.simulations.callable_simulation import CallableSimulation
from quadpi_core.discrepancy.simulations.simulation_base import Column, Simulation, Tolerances
from quadpi_core.discrepancy.simulations.vehicle_simulation import VehicleSimulation

__all__ = ["CallableSimulation", "Column", "Simulation", "Tolerances", "VehicleSimulation"]
