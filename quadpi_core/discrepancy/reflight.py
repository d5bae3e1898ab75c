# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The gap in flight, before and after: roll-outs, the same references flown again, coverage of intervals.

Each flight is judged by what all other flights showed. In an open-loop roll-out a rigid body starts at the
measured state of many instants and moves by the simulated wrench of the rotor speeds that were measured;
nothing corrects it. The error that is left with the measured wrench itself comes from sensors and estimator:
no simulation gets below it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.stats import t as student

from quadpi_core.discrepancy.acceptance import FEW_FLIGHTS
from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation, as_it_was, augmented
from quadpi_core.discrepancy.discrepancy_result import (
    ERROR_NAMES,
    BeforeAfter,
    ClosedLoops,
    Coverage,
    Discovery,
    Reflights,
    Rollouts,
)
from quadpi_core.discrepancy.effect_response import Compared, residual
from quadpi_core.discrepancy.simulations import Simulation, VehicleSimulation
from quadpi_core.errors import DiscrepancyError, LogError, SimulationError, one_line
from quadpi_core.flight import AXES, Flight, OdometryStream, Stamps
from quadpi_core.frames import Array, rotate_body_to_world, rotate_world_to_body
from quadpi_core.logs.bag_files import Bag
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.paths import parse_json
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.signals.chain import interpolate_columns
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.simulated_bags import read_truth
from quadpi_core.simulation.truth import STEP_HZ, Truth
from quadpi_core.vehicle import Vehicle

# Duration of a roll-out: long enough for a missing force to show, and before an unstable vehicle diverges.
HORIZON_S = 0.5
# Time between starts [s]: the errors of neighbours are then about independent.
_EVERY_S = 0.25
# Steps of the integration per second.
_ROLLOUT_HZ = 100.0
_NO_VEHICLE_DOES = "twice what the fastest real flights reach: a roll-out beyond it has diverged"
DIVERGED_SPEED = Threshold("speed of a lost roll-out", 50.0, "m/s", _NO_VEHICLE_DOES, "flights up to 22 m/s")
DIVERGED_RATE = Threshold(
    "body rate of a lost roll-out", 60.0, "rad/s", _NO_VEHICLE_DOES, "flights up to 1 330 degrees/s"
)
BEYOND_CHANCE = Threshold(
    "roll-outs that get worse beyond chance",
    0.95,
    "probability that they do on average over flights, by Student's t",
    "the level of the intervals that are stated",
    CONVENTION,
)


class Motion(NamedTuple):
    """States (K, ·) of K bodies, or their derivatives; velocity [m/s] and position [m] in the world."""

    position: Array
    velocity: Array
    attitude: Array
    rates: Array

    @classmethod
    def along(cls, flown: Flight | Truth | OdometryStream, time: Array | Stamps, at: Array) -> Motion:
        """States at some times of what flew, whose samples have these times."""
        velocity = rotate_body_to_world(flown.attitude, flown.velocity)
        states = (flown.position, velocity, flown.attitude, flown.rates)
        return cls(*(interpolate_columns(time, values, at) for values in states)).normalised()

    def normalised(self) -> Motion:
        """With unit quaternions."""
        return self._replace(attitude=self.attitude / np.linalg.norm(self.attitude, axis=1, keepdims=True))

    def squared_errors(self, true: Motion) -> Array:
        """Squares (K, 4) of the distances from other states, as `ERROR_NAMES`."""
        cosine = np.abs(np.sum(self.attitude * true.attitude, axis=1)).clip(max=1.0)
        position, velocity, _, rates = (
            np.square(own - other).sum(axis=1) for own, other in zip(self, true, strict=True)
        )
        return np.stack((position, velocity, np.square(np.degrees(2.0 * np.arccos(cosine))), rates), axis=1)


# Wrench (K, 6) of K bodies in their states, each at its own time [s] of the flight.
_Wrench: TypeAlias = Callable[[Array, Motion], Array]


def rollout(flight: Flight, simulation: Simulation, horizon_s: float = HORIZON_S) -> Array:
    """Squared errors (S, 4) at the end of roll-outs of a simulation from many instants of a flight.

    They are of `ERROR_NAMES`, and NaN where a roll-out diverged, beyond which no simulation can judge. Errors
    of sensors that the simulation has as effects are removed from the flight first.

    Raises:
        DiscrepancyError: for a flight shorter than the horizon.
    """
    if isinstance(simulation, AugmentedSimulation):
        corrected = simulation.corrected(flight)
        simulation = simulation.answering(flight, corrected).physical.departing_from(corrected)
        flight = corrected
    # At three instants: effects of changing rotor speeds see differences over a whole step, and these add up.
    around = 0.5 / _ROLLOUT_HZ * np.array([-1.0, 0.0, 1.0])

    def wrench(time: Array, motion: Motion) -> Array:
        instants = (time[:, None] + around).ravel()
        position, velocity, attitude, rates = (np.repeat(values, 3, axis=0) for values in motion)
        none = np.zeros((len(instants), 3))
        asked = replace(
            flight,
            time=instants,
            position=position,
            attitude=attitude,
            velocity=rotate_world_to_body(attitude, velocity),
            rates=rates,
            angular_acceleration=none,
            specific_force=none,
            rotor_speeds=interpolate_columns(flight.time, flight.rotor_speeds, instants),
            wind=interpolate_columns(flight.time, flight.wind, instants),
        )
        return simulation.wrench(asked)[1::3]

    return _rolled_out(flight, simulation.vehicle, wrench, horizon_s)


def rollout_floor(flight: Flight, vehicle: Vehicle) -> Array:
    """As :func:`rollout`, of the measured wrench of the flight, whose errors no simulation causes."""
    measured = measured_wrench(flight, vehicle)
    return _rolled_out(
        flight, vehicle, lambda at, _: interpolate_columns(flight.time, measured, at), HORIZON_S
    )


def _rolled_out(flight: Flight, vehicle: Vehicle, wrench: _Wrench, horizon_s: float) -> Array:
    first, last = flight.time[0], flight.time[-1] - horizon_s
    if last <= first:
        raise DiscrepancyError(f"{flight.source}: shorter than the {horizon_s:g} s of a roll-out")
    time = np.arange(first, last, _EVERY_S)
    steps = max(1, round(horizon_s * _ROLLOUT_HZ))
    step = horizon_s / steps
    begin = motion = Motion.along(flight, flight.time, time)
    lost = np.zeros(len(time), dtype=np.bool_)
    for _ in range(steps):
        ahead = motion
        # The slope half a step ahead is that of the whole step.
        for at, span in ((time, 0.5 * step), (time + 0.5 * step, step)):
            slope = _slope(vehicle, wrench(at, ahead), ahead)
            moved = zip(motion, slope, strict=True)
            ahead = Motion(*(value + span * change for value, change in moved)).normalised()
            speed, rates = (np.linalg.norm(own, axis=1) for own in (ahead.velocity, ahead.rates))
            lost |= ~((speed < DIVERGED_SPEED.value) & (rates < DIVERGED_RATE.value))
            # A model is asked for nothing beyond numbers: what is lost waits at its start.
            both = zip(begin, ahead, strict=True)
            ahead = Motion(*(np.where(lost[:, None], start, there) for start, there in both))
        motion, time = ahead, time + step
    squares = motion.squared_errors(Motion.along(flight, flight.time, time))
    squares[lost] = np.nan
    return squares


def _slope(vehicle: Vehicle, wrench: Array, motion: Motion) -> Motion:
    """Equations of motion: v̇ = R F/m + g, I Ω̇ = M − Ω × IΩ, q̇ = ½ q (0, Ω)."""
    acceleration = rotate_body_to_world(motion.attitude, wrench[:, :3] / vehicle.mass_kg)
    acceleration[:, 2] += vehicle.gravity_m_s2
    moment = wrench[:, 3:] - np.cross(motion.rates, motion.rates @ vehicle.inertia)
    w, x, y, z = motion.attitude.T
    p, q, r = motion.rates.T
    turning = np.stack(
        (-x * p - y * q - z * r, w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p), axis=1
    )
    return Motion(motion.velocity, acceleration, 0.5 * turning, moment @ np.linalg.inv(vehicle.inertia).T)


def reflights(discovery: Discovery) -> Reflights:
    """Roll-outs, closed loops and, for a model with intervals, their coverage."""
    compared = discovery.found.regression.flights
    before, flights = compared[0].simulation, [one.flight for one in compared]
    after = [augmented(discovery, without=place) for place in range(len(flights))]
    was = [_as_it_was(discovery, place) for place in range(len(flights))]
    floor = [_floor(one, added.vehicle) for one, added in zip(compared, after, strict=True)]
    return Reflights(
        rollout=rollouts(was, [rollout(*own) for own in zip(flights, after, strict=True)], floor),
        closed_loop=closed_loops(flights, before, after),
        coverage=coverages(compared, after),
    )


def _as_it_was(discovery: Discovery, place: int) -> Array:
    """Roll-outs of a flight by the simulation as it is, with what the flight has of its own."""
    simulation, regression = as_it_was(discovery, place), discovery.found.regression
    one = regression.flights[place]
    if simulation is one.simulation:
        return one.once("roll-outs", lambda: rollout(one.flight, simulation))
    key = "roll-outs", discovery.found.chosen, place
    return regression.once(key, lambda: rollout(one.flight, simulation))


def _floor(one: Compared, vehicle: Vehicle) -> Array:
    return one.once(("floor", vehicle.fingerprint), lambda: rollout_floor(one.flight, vehicle))


def rollouts(*of_flights: Sequence[Array]) -> Rollouts:
    """From squares (S, 4) of each flight before, after and at the floor; none where all of one are lost."""
    squares = [np.concatenate(own) for own in of_flights]
    lost = [int(np.isnan(own[:, 0]).sum()) for own in squares]
    starts = len(squares[0])
    errors = _errors(squares) if max(lost) < starts else {}
    return Rollouts(
        HORIZON_S,
        starts - lost[0],
        {name: error for name, error in errors.items() if name != "position_m"},
        dict(zip(BeforeAfter._fields, lost, strict=True)),
        growing_by_chance(*of_flights[:2]),
    )


def growing_by_chance(before: Sequence[Array], after: Sequence[Array]) -> frozenset[str]:
    """Names of errors that grow by no more than chance makes of flights, from squares (S, 4) of each.

    None of flights so few that they do not predict each other.
    """
    lasting = [
        both for both in zip(before, after, strict=True) if not any(np.isnan(own).all() for own in both)
    ]
    if len(lasting) < FEW_FLIGHTS.value:
        return frozenset()
    means = np.array([[np.nanmean(own, axis=0) for own in both] for both in lasting])
    growth = 0.5 * np.diff(np.log(np.maximum(means, np.finfo(float).tiny)), axis=1)[:, 0]
    error = np.std(growth, axis=0, ddof=1) / np.sqrt(len(growth))
    chance = growth.mean(axis=0) <= float(student.ppf(BEYOND_CHANCE.value, len(growth) - 1)) * error
    return frozenset(name for name, own in zip(ERROR_NAMES, chance, strict=True) if own)


def _errors(squares: Sequence[Array]) -> dict[str, BeforeAfter]:
    """Root mean square before, after and at the floor, by name, of squares (S, 4) where these are numbers."""
    rms = np.sqrt([np.nanmean(own, axis=0) for own in squares])
    return {name: BeforeAfter(*own) for name, own in zip(ERROR_NAMES, rms.T.tolist(), strict=True)}


def closed_loops(
    flights: Sequence[Flight], before: Simulation, after: Sequence[AugmentedSimulation]
) -> ClosedLoops:
    """Errors of references flown again by the simulation, before and after, against the measured flights.

    Only flights of quadpi's own simulation record their reference. The floor is the error of the estimator,
    known where the bag holds the truth.
    """
    base = before.base if isinstance(before, AugmentedSimulation) else before
    if not isinstance(base, VehicleSimulation):
        return ClosedLoops(0, missing="only the simulation of a vehicle file can fly")
    plans = [_plan(flight) for flight in flights]
    if not any(plans):
        return ClosedLoops(0, missing="the bags hold no reference that the simulation could fly again")
    nominal = SimulatedVehicle.load(base.vehicle_file)
    squares, lost = [], []
    for flight, plan, added in zip(flights, plans, after, strict=True):
        if plan is None:
            continue
        assert isinstance(added.base, VehicleSimulation)  # as before
        altered = replace(nominal, aerodynamics=added.base.model, effects=added.effects)
        try:
            ways = fly_again(plan, nominal), fly_again(plan, altered), read_truth(flight.source).odometry
        except SimulationError as error:
            lost.append(str(error))
            continue
        squares.append([squared_distances(flight, way) for way in ways])
    if not squares:
        return ClosedLoops(0, lost=tuple(lost))
    errors = _errors([np.concatenate(own) for own in zip(*squares, strict=True)])
    return ClosedLoops(len(squares), lost=tuple(lost), errors=errors)


def fly_again(plan: FlightPlan, vehicle: SimulatedVehicle) -> Truth:
    """The reference of a plan flown by a vehicle with its own effects, without those of the plan.

    Raises:
        SimulationError: if it gets out of control or to the ground.
    """
    reference = plan.reference(STEP_HZ)
    return simulate_flight(plan.name, vehicle, reference, known_wind=plan.known_wind, seed=plan.seed)


def squared_distances(flight: Flight, other: Truth | OdometryStream) -> Array:
    """Squares (S, 4) as `ERROR_NAMES` of how far a flight was from another track, where both were."""
    time_ns, other_ns = np.rint(1e9 * flight.time), other.time_ns - flight.start_ns
    at = time_ns[(time_ns >= other_ns[0]) & (time_ns <= other_ns[-1])]
    return Motion.along(flight, time_ns, at).squared_errors(Motion.along(other, other_ns, at))


def _plan(flight: Flight) -> FlightPlan | None:
    """The plan in the bag of a flight; None without a bag, or if the bag is not simulated."""
    path = Path(flight.source)
    if not path.exists():
        return None
    try:
        with Bag(path) as bag:
            text = bag.metadata.get("plan")
    except LogError:
        return None
    try:
        return None if text is None else FlightPlan.from_dict(parse_json(text), str(path))
    except ValueError as error:
        raise LogError(f"{path}: `plan` in its metadata: {one_line(error)}") from error


def coverages(compared: Sequence[Compared], after: Sequence[Simulation]) -> dict[str, Coverage]:
    """Share of samples inside a model's intervals, per axis, about its predictions before and after.

    Nothing for a simulation without intervals.
    """
    inside = []
    for one, added in zip(compared, after, strict=True):
        margins = one.margins
        if margins is None:
            return {}
        both = (one.whole_residual, residual(one.flight, added))
        inside.append([inside_interval(left, margins.lower, margins.upper) for left in both])
    shares = [np.concatenate(own).mean(axis=0) for own in zip(*inside, strict=True)]
    return {axis: Coverage(*own) for axis, own in zip(AXES, np.transpose(shares).tolist(), strict=True)}
