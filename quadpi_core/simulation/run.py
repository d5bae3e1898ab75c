# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of flight plans: fly each, sample its sensors, and write all bags or none."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

import numpy as np

from quadpi_core import array_checks
from quadpi_core.brief_repr import brief_repr
from quadpi_core.elementary import arctangent
from quadpi_core.errors import SimulationError, named_in
from quadpi_core.frames import Array
from quadpi_core.parallel import DEFAULT_WORKERS, Progress, Workers
from quadpi_core.paths import require_file, whole_outputs
from quadpi_core.simulation.dynamics import TILT_MAX_DEG
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.sensors import Sensed, sense
from quadpi_core.simulation.simulated_bags import write_simulated_bag
from quadpi_core.simulation.truth import STEP_HZ, Reference, Truth
from quadpi_core.thresholds import CONVENTION, Threshold

SIMULATED_AIRSPEED_M_S = Threshold(
    "largest airspeed of a reference",
    16.0,
    "m/s",
    "the rotor-local model was measured up to 14; a flight against such a wind moves forward in it too",
    "Bebop 2 in a wind tunnel",
)
EXCITED_TILT_MAX_DEG = Threshold(
    "largest tilt of path and excitation together", 75.0, "degrees", "ten more than of the path", CONVENTION
)
YAW_RATE_MAX_DEG_S = Threshold(
    "largest yaw rate of a reference", 360.0, "degrees/s", "a faster turn is a mistake in units", CONVENTION
)


@dataclass(frozen=True)
class SimulatedFlight:
    """A flight that was flown and written as a bag."""

    __repr__ = brief_repr

    plan: FlightPlan
    truth: Truth
    bag: Path


def simulate(
    plans: Sequence[FlightPlan],
    output: Path | str,
    *,
    workers: Workers = DEFAULT_WORKERS,
) -> list[SimulatedFlight]:
    """Fly the plans, several at a time, and write a bag for each into a folder: all of them or none.

    Args:
        plans: with different names, such as `load_scenario(name_or_path).flights`.
        output: folder; bags of the same names in it are replaced.
        workers: their count is the number of simultaneous flights, by default one per core. Flights fly in
            threads of this process, with any scheduler.

    Returns:
        The flights in the order of the plans.

    Raises:
        ArgumentError: for what are no plans, folder or workers.
        SimulationError: naming flight, time and state, for a reference that the vehicle cannot follow and a
            vehicle out of control; and for sensors that are not possible.
        VehicleError: for a vehicle that cannot be simulated.
        OutputError: if a bag cannot be written.
    """
    hint = "load_scenario(name_or_path).flights gives them"
    plans = array_checks.several("plans", plans, FlightPlan, hint)
    output = array_checks.path("output", output)
    array_checks.instance("workers", workers, Workers)
    vehicles, suites = {}, {}
    for plan in plans:
        with named_in(f"scenario {plan.scenario}, flight {plan.name}"):
            if plan.vehicle not in vehicles:
                vehicles[plan.vehicle] = SimulatedVehicle.load(plan.vehicle)
            if plan.noise not in suites:
                suites[plan.noise] = SensorSuite.load(plan.noise)
        require_file(output / f"{plan.name}.mcap")

    def flown(plan: FlightPlan, staging: Path) -> SimulatedFlight:
        bag = f"{plan.name}.mcap"
        truth, sensed = fly_and_sense(plan, vehicles[plan.vehicle], suites[plan.noise])
        write_simulated_bag(staging / bag, plan, truth, sensed)
        return SimulatedFlight(plan, truth, output / bag)

    flights: list[SimulatedFlight] = []
    whole_s = sum(plan.duration_s for plan in plans)
    # Threads suffice: flight, random numbers and compression run outside the interpreter's lock.
    with whole_outputs(output) as staging, ThreadPoolExecutor(workers.count or os.cpu_count()) as pool:
        # Of several that fail, the first of the plans is reported, not the first in time.
        for flight in pool.map(flown, plans, repeat(staging)):
            flights.append(flight)
            seconds = sum(flight.plan.duration_s for flight in flights)
            note = f"{len(flights)} of {len(plans)} flights"
            workers.progress(Progress("Flying", seconds, whole_s, "s", note))
    return flights


def fly_and_sense(plan: FlightPlan, vehicle: SimulatedVehicle, suite: SensorSuite) -> tuple[Truth, Sensed]:
    """Truth of a flight, and the messages of its sensors.

    Raises:
        SimulationError: see :func:`simulate`.
    """
    truth = fly_plan(plan, vehicle)
    effects = vehicle.with_own(plan.effects)
    return truth, sense(truth, vehicle.vehicle, suite, effects, plan.faults, plan.seed)


def fly_plan(plan: FlightPlan, vehicle: SimulatedVehicle) -> Truth:
    """Truth of a flight.

    Raises:
        SimulationError: see :func:`simulate`.
    """
    reference = plan.reference(STEP_HZ)
    require_reachable(plan, vehicle, reference)
    known_wind, effects, seed = plan.known_wind, plan.effects, plan.seed
    return simulate_flight(plan.name, vehicle, reference, known_wind=known_wind, effects=effects, seed=seed)


def require_reachable(plan: FlightPlan, vehicle: SimulatedVehicle, reference: Reference) -> None:
    """Refuse a reference of a plan that demands more than the vehicle can do; drag is neglected.

    Raises:
        SimulationError: naming flight and instant, the demand and the limit.
    """
    nominal = vehicle.vehicle
    wind = 0.0 if plan.known_wind is None else plan.known_wind
    gravity = np.array([0.0, 0.0, nominal.gravity_m_s2])
    force = reference.acceleration - gravity
    upright = arctangent(_size(force[:, :2]), -force[:, 2])
    thrust = _size(force) + reference.thrust * nominal.gravity_m_s2
    limits: tuple[tuple[str, str, Array, float], ...] = (
        ("specific force", "m/s²", thrust, vehicle.greatest_thrust / nominal.mass_kg),
        ("specific force downward", "m/s²", -thrust, 0.0),
        ("airspeed", "m/s", _size(reference.velocity - wind), SIMULATED_AIRSPEED_M_S.value),
        ("tilt along the path", "degrees", np.degrees(upright), TILT_MAX_DEG.value),
        ("tilt", "degrees", np.degrees(upright + _size(reference.tilt)), EXCITED_TILT_MAX_DEG.value),
        ("yaw rate", "degrees/s", np.degrees(np.abs(reference.yaw_rate)), YAW_RATE_MAX_DEG_S.value),
    )
    for quantity, unit, demanded, available in limits:
        worst = int(np.argmax(demanded))
        # Written so that NaN is refused, too.
        if not demanded[worst] <= available:
            seconds = plan.duration_s * worst / (len(reference) - 1)
            raise SimulationError(
                f"flight {plan.name}: unreachable reference: at {seconds:.2f} s it demands "
                f"{demanded[worst]:.1f} {unit} of {quantity}, and {nominal.name} has {available:.1f}"
            )


def _size(vectors: Array) -> Array:
    size: Array = np.sqrt((vectors * vectors).sum(axis=1))
    return size
