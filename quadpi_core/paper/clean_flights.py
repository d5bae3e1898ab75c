# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Noise-free flights: flown by the simulation for the occasion, or the truth that its bags hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from quadpi_core.errors import LogError
from quadpi_core.flight import Flight
from quadpi_core.logs.bags import bag_vehicle
from quadpi_core.simulation.flight_plan import FlightPlan
from quadpi_core.simulation.run import fly_plan
from quadpi_core.simulation.simulated_bags import read_truth
from quadpi_core.simulation.simulated_vehicle import SimulatedVehicle
from quadpi_core.vehicle import Vehicle


def simulated_flights(
    plans: Sequence[FlightPlan], progress: Callable[[str], None] = lambda _: None
) -> list[Flight]:
    """Fly the plans; nothing senses them.

    Args:
        plans: of the flights.
        progress: called with the name of each flight before it is flown.

    Raises:
        SimulationError, VehicleError: as :func:`quadpi_core.simulation.run.simulate`.
    """
    flights = []
    for plan in plans:
        progress(plan.name)
        vehicle = SimulatedVehicle.load(plan.vehicle)
        flights.append(fly_plan(plan, vehicle).flight())
    return flights


def recorded_flight(path: Path, vehicle: Vehicle) -> Flight:
    """The truth of a simulated flight in the place of an estimated one.

    Args:
        path: bag that `quadpi simulate` wrote.
        vehicle: that flew.

    Raises:
        LogError: naming the bag, for one without the truth, or of another vehicle.
    """
    truth = read_truth(path)
    if (flown := bag_vehicle(path)) != vehicle.name:
        raise LogError(f"{path}: is a flight of vehicle {flown}, not of {vehicle.name}")
    state = truth.odometry
    return Flight(
        name=path.stem,
        vehicle=vehicle.name,
        source=str(path),
        start_ns=int(truth.time_ns[0]),
        time=1e-9 * (truth.time_ns - truth.time_ns[0]),
        position=state.position,
        attitude=state.attitude,
        velocity=state.velocity,
        rates=state.rates,
        angular_acceleration=truth.angular_acceleration,
        specific_force=truth.wrench[:, :3] / truth.mass,
        rotor_speeds=truth.rotor_speeds,
        wind=truth.wind,
    )
