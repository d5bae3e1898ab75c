# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The gap in flight, before and after: roll-outs, the same references flown again, coverage of intervals.

Each flight is judged by what all other flights showed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from quadpi_core.bounded_files import parse_json
from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.callable_simulation import ModelSimulation
from quadpi_core.discrepancy.discrepancy_result import (
    BeforeAfter,
    ClosedLoops,
    Coverage,
    Discovery,
    Reflights,
    Rollouts,
)
from quadpi_core.discrepancy.effect_response import residual
from quadpi_core.discrepancy.effect_sets import augmented
from quadpi_core.discrepancy.rollout import HORIZON_S, RolloutError, rollout, rollout_floor
from quadpi_core.discrepancy.simulations import Simulation, VehicleSimulation
from quadpi_core.errors import LogError, SimulationError, one_line
from quadpi_core.flight import AXES, MAX_GAP_NS, Flight, Stamps
from quadpi_core.frames import Array
from quadpi_core.logs.bag_files import Bag
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.rotations import rotate_body_to_world
from quadpi_core.signals.resample import interpolate, interpolate_attitude
from quadpi_core.simulation.flight_plan import FlightPlan
from quadpi_core.simulation.flying import simulate_flight
from quadpi_core.simulation.simulated_bags import read_truth
from quadpi_core.simulation.simulated_vehicle import SimulatedVehicle
from quadpi_core.simulation.truth import STEP_HZ

_FLOWN = ("position_m", "velocity_m_s", "attitude_deg", "rates_rad_s")
_NO_REFERENCE = "the bags hold no reference that the simulation could fly again"
_NO_VEHICLE = "only the simulation of a vehicle file can fly"


@dataclass(frozen=True)
class Track:
    """Motion at stamps (N,): position [m] and velocity [m/s] in the world, attitude, rates."""

    time_ns: Stamps
    position: Array
    velocity: Array
    attitude: Array
    rates: Array

    @classmethod
    def of(cls, flight: Flight) -> Track:
        """Of a flight, measured or simulated."""
        stamps = flight.start_ns + np.round(1e9 * flight.time).astype(np.int64)
        velocity = rotate_body_to_world(flight.attitude, flight.velocity)
        return cls(stamps, flight.position, velocity, flight.attitude, flight.rates)

    def squares(self, other: Track) -> tuple[Array, int]:
        """Sums (4,) of the squared distances to another track, as `_FLOWN`, and over how many samples."""
        inside = (self.time_ns >= other.time_ns[0]) & (self.time_ns <= other.time_ns[-1])
        at = self.time_ns[inside]

        def apart(own: Array, others: Array) -> float:
            there = interpolate(other.time_ns, others, at, MAX_GAP_NS).values
            return float(np.square(own[inside] - there).sum())

        there = interpolate_attitude(other.time_ns, other.attitude, at, MAX_GAP_NS).values
        cosine = np.abs(np.sum(self.attitude[inside] * there, axis=1)).clip(max=1.0)
        sums = (
            apart(self.position, other.position),
            apart(self.velocity, other.velocity),
            float(np.square(np.degrees(2.0 * np.arccos(cosine))).sum()),
            apart(self.rates, other.rates),
        )
        return np.array(sums), len(at)


def reflights(discovery: Discovery) -> Reflights:
    """Roll-outs, closed loops and, for a model with intervals, their coverage."""
    compared = discovery.found.regression.flights
    before = compared[0].simulation
    flights = [one.flight for one in compared]
    after = [augmented(discovery, without=place) for place in range(len(flights))]
    base = before.base if isinstance(before, AugmentedSimulation) else before
    return Reflights(
        rollout=rollouts(flights, [before] * len(flights), after),
        closed_loop=closed_loops(flights, before, after),
        coverage=coverages(flights, base, before, after) if isinstance(base, ModelSimulation) else {},
    )


def rollouts(
    flights: Sequence[Flight], before: Sequence[Simulation], after: Sequence[Simulation]
) -> Rollouts:
    """Errors of roll-outs before, after, and with the measured wrench, over all flights."""
    first = [rollout(flight, simulation) for flight, simulation in zip(flights, before, strict=True)]
    then = [rollout(flight, simulation) for flight, simulation in zip(flights, after, strict=True)]
    floor = [
        rollout_floor(flight, simulation.vehicle) for flight, simulation in zip(flights, after, strict=True)
    ]
    starts = [error.starts for error in first]

    def rms(errors: Sequence[RolloutError], name: str) -> float:
        return float(np.sqrt(np.average(np.square([getattr(e, name) for e in errors]), weights=starts)))

    return Rollouts(
        horizon_s=HORIZON_S,
        starts=sum(starts),
        errors={
            name: BeforeAfter(rms(first, name), rms(then, name), rms(floor, name))
            for name in RolloutError._fields
            if name != "starts"
        },
    )


def closed_loops(
    flights: Sequence[Flight], before: Simulation, after: Sequence[AugmentedSimulation]
) -> ClosedLoops:
    """References of flights flown again by the simulation, before and after, beside the measured flights.

    Only flights of quadpi's own simulation record their reference; that of other controllers is not known.
    The floor is the error of the estimator, where the bag holds the truth.
    """
    base = before.base if isinstance(before, AugmentedSimulation) else before
    if not isinstance(base, VehicleSimulation):
        return ClosedLoops(0, missing=_NO_VEHICLE)
    plans = [_plan(flight) for flight in flights]
    if not any(plans):
        return ClosedLoops(0, missing=_NO_REFERENCE)
    nominal = SimulatedVehicle.load(base.vehicle_file)
    sums, samples, lost = {when: np.zeros(len(_FLOWN)) for when in ("before", "after", "floor")}, 0, []
    flown = 0
    for flight, plan, augmented_ in zip(flights, plans, after, strict=True):
        if plan is None:
            continue
        assert isinstance(augmented_.base, VehicleSimulation)  # as before
        added = replace(nominal, aerodynamics=augmented_.base.model, effects=augmented_.effects)
        track = Track.of(flight)
        try:
            ways = {"before": fly_again(plan, nominal), "after": fly_again(plan, added)}
        except SimulationError as error:
            lost.append(str(error))
            continue
        ways["floor"] = _true_track(flight)
        for when, other in ways.items():
            squares, count = track.squares(other)
            sums[when] += squares
        samples += count
        flown += 1
    if not flown:
        return ClosedLoops(0, lost=tuple(lost))
    rms = {when: np.sqrt(total / samples) for when, total in sums.items()}
    errors = {
        name: BeforeAfter(**{when: float(values[index]) for when, values in rms.items()})
        for index, name in enumerate(_FLOWN)
    }
    shares = []
    for own in errors.values():
        removable, kept = _beyond(own.before, own.floor), _beyond(own.after, own.floor)
        shares.append(1.0 - kept / removable if removable > 0.0 else 0.0)
    return ClosedLoops(flown, lost=tuple(lost), errors=errors, reduction=float(np.mean(shares)))


def _beyond(rms: float, floor: float) -> float:
    return float(np.sqrt(max(rms * rms - floor * floor, 0.0)))


def fly_again(plan: FlightPlan, vehicle: SimulatedVehicle) -> Track:
    """The reference of a plan flown by a vehicle with its own effects, without those of the plan.

    Raises:
        SimulationError: if it gets out of control or to the ground.
    """
    truth = simulate_flight(
        plan.name, vehicle, plan.reference(STEP_HZ), known_wind=plan.known_wind, seed=plan.seed
    )
    return Track.of(truth.flight())


def _plan(flight: Flight) -> FlightPlan | None:
    """The plan recorded in the bag of a flight; None where there is no bag, or the bag is not simulated."""
    path = Path(flight.source)
    if not path.exists():
        return None
    try:
        with Bag(path) as bag:
            text = bag.metadata.get("plan")
    except LogError:
        return None
    if text is None:
        return None
    try:
        return FlightPlan.from_dict(parse_json(text), str(path))
    except ValueError as error:
        raise LogError(f"{path}: `plan` in its metadata: {one_line(error)}") from error


def _true_track(flight: Flight) -> Track:
    truth = read_truth(flight.source)
    odometry = truth.odometry
    velocity = rotate_body_to_world(odometry.attitude, odometry.velocity)
    return Track(odometry.time_ns, odometry.position, velocity, odometry.attitude, odometry.rates)


def coverages(
    flights: Sequence[Flight], model: ModelSimulation, before: Simulation, after: Iterable[Simulation]
) -> dict[str, Coverage]:
    """Share of samples in the intervals of a model, per axis: about its predictions, and those after."""
    inside = {"before": np.zeros(len(AXES)), "after": np.zeros(len(AXES))}
    samples = 0
    for flight, added in zip(flights, after, strict=True):
        predicted = model.wrench(flight)
        lower, upper = model.intervals(flight)
        for when, simulation in (("before", before), ("after", added)):
            left = residual(flight, simulation)
            inside[when] += inside_interval(left, lower - predicted, upper - predicted).sum(axis=0)
        samples += len(flight)
    return {
        axis: Coverage(**{when: float(count[index]) / samples for when, count in inside.items()})
        for index, axis in enumerate(AXES)
    }
