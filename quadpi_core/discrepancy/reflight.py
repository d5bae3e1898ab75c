# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The gap in flight, before and after: roll-outs, the same references flown again, coverage of intervals.

Each flight is judged by what all other flights showed. In an open-loop roll-out a rigid body starts at the
measured state of many instants and moves by the simulated wrench of the rotor speeds that were measured;
nothing corrects it. The error that is left with the measured wrench itself comes from sensors and estimator:
no simulation gets below it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.bounded_files import parse_json
from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation, as_it_was, augmented
from quadpi_core.discrepancy.discrepancy_result import (
    BeforeAfter,
    ClosedLoops,
    Coverage,
    Discovery,
    Reflights,
    Rollouts,
)
from quadpi_core.discrepancy.effect_response import residual
from quadpi_core.discrepancy.simulations import Simulation, VehicleSimulation
from quadpi_core.errors import DiscrepancyError, LogError, SimulationError, one_line
from quadpi_core.flight import AXES, MAX_GAP_NS, Flight, Stamps
from quadpi_core.frames import Array
from quadpi_core.logs.bag_files import Bag
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.rotations import rotate_body_to_world, rotate_world_to_body
from quadpi_core.signals.resample import interpolate, interpolate_attitude, interpolate_columns
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.simulated_bags import read_truth
from quadpi_core.simulation.truth import STEP_HZ
from quadpi_core.thresholds import Threshold
from quadpi_core.vehicle import Vehicle

# Duration of a roll-out: long enough for a missing force to show, and before an unstable vehicle diverges.
HORIZON_S = 0.5
# Time between starts [s]: the errors of neighbours are then about independent.
_EVERY_S = 0.25
_NO_VEHICLE_DOES = "twice what the fastest real flights reach: a roll-out beyond it has diverged"
DIVERGED_SPEED = Threshold("speed of a lost roll-out", 50.0, "m/s", _NO_VEHICLE_DOES, "flights up to 22 m/s")
DIVERGED_RATE = Threshold(
    "body rate of a lost roll-out", 60.0, "rad/s", _NO_VEHICLE_DOES, "flights up to 1 330 degrees/s"
)
# Steps of the integration per second.
_ROLLOUT_HZ = 100.0


class RolloutError(NamedTuple):
    """Root-mean-square errors at the horizon, over all starts.

    Attributes:
        velocity_m_s: over ground.
        attitude_deg: angle of rotation.
        rates_rad_s: body rates.
        starts: number of roll-outs, those lost left out.
        lost: roll-outs that diverged, beyond which no simulation can judge.
    """

    velocity_m_s: float
    attitude_deg: float
    rates_rad_s: float
    starts: int
    lost: int = 0


class _Motion(NamedTuple):
    """State (K, ·) of K bodies; velocity [m/s] and position [m] in the world."""

    position: Array
    velocity: Array
    attitude: Array
    rates: Array

    def moved(self, slope: _Motion, step: float) -> _Motion:
        position, velocity, attitude, rates = (
            value + step * change for value, change in zip(self, slope, strict=True)
        )
        return _Motion(position, velocity, attitude / np.linalg.norm(attitude, axis=1, keepdims=True), rates)

    def lost(self) -> npt.NDArray[np.bool_]:
        """Bodies (K,) that fly or turn as no vehicle does."""
        speed, rates = (np.linalg.norm(own, axis=1) for own in (self.velocity, self.rates))
        with np.errstate(invalid="ignore"):
            kept = (speed < DIVERGED_SPEED.value) & (rates < DIVERGED_RATE.value)
        lost: npt.NDArray[np.bool_] = ~kept
        return lost

    def where(self, chosen: npt.NDArray[np.bool_], other: _Motion) -> _Motion:
        """These bodies, but another's motion where chosen (K,)."""
        return _Motion(*(np.where(chosen[:, None], b, a) for a, b in zip(self, other, strict=True)))


# Wrench (K, 6) of K bodies in their states, each at its own time [s] of the flight.
_Wrench: TypeAlias = Callable[[Array, _Motion], Array]


def rollout(flight: Flight, simulation: Simulation, horizon_s: float = HORIZON_S) -> RolloutError:
    """Errors of roll-outs of a simulation from many instants of a flight.

    Errors of sensors that the simulation has as effects are removed from the flight first.

    Raises:
        DiscrepancyError: for a flight shorter than the horizon.
    """
    if isinstance(simulation, AugmentedSimulation):
        corrected = simulation.corrected(flight)
        simulation = simulation.answering(flight, corrected).physical.departing_from(corrected)
        flight = corrected
    return _rolled_out(flight, simulation.vehicle, _simulated(flight, simulation), horizon_s)


def rollout_floor(flight: Flight, vehicle: Vehicle) -> RolloutError:
    """Errors of roll-outs of the measured wrench of a flight, which no simulation causes.

    Raises:
        DiscrepancyError: for a flight shorter than the horizon.
    """
    measured = measured_wrench(flight, vehicle)

    def wrench(time: Array, _: _Motion) -> Array:
        return interpolate_columns(flight.time, measured, time)

    return _rolled_out(flight, vehicle, wrench, HORIZON_S)


def _simulated(flight: Flight, simulation: Simulation) -> _Wrench:
    """The wrench of a simulation for bodies in given states, with rotor speeds and wind of the flight.

    Each is evaluated at three instants, so that effects of changing rotor speeds see differences over a whole
    step, which add up to the change of the speeds.
    """
    step = 0.5 / _ROLLOUT_HZ

    def wrench(time: Array, motion: _Motion) -> Array:
        instants = (time[:, None] + step * np.array([-1.0, 0.0, 1.0])).ravel()
        at = [np.repeat(values, 3, axis=0) for values in motion]
        position, velocity, attitude, rates = at
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

    return wrench


def _rolled_out(flight: Flight, vehicle: Vehicle, wrench: _Wrench, horizon_s: float) -> RolloutError:
    first, last = flight.time[0], flight.time[-1] - horizon_s
    if last <= first:
        raise DiscrepancyError(f"{flight.source}: shorter than the {horizon_s:g} s of a roll-out")
    time = np.arange(first, last, _EVERY_S)
    motion = _measured(flight, time)
    steps = max(1, round(horizon_s * _ROLLOUT_HZ))
    step = horizon_s / steps
    begin, lost = motion, np.zeros(len(time), dtype=np.bool_)
    for _ in range(steps):
        slope = _slope(vehicle, wrench(time, motion), motion)
        halfway = motion.moved(slope, 0.5 * step)
        lost |= halfway.lost()
        # A model is asked for nothing beyond numbers: what is lost waits at its start.
        halfway = halfway.where(lost, begin)
        slope = _slope(vehicle, wrench(time + 0.5 * step, halfway), halfway)
        motion = motion.moved(slope, step)
        lost |= motion.lost()
        motion = motion.where(lost, begin)
        time = time + step
    if lost.all():
        return RolloutError(0.0, 0.0, 0.0, starts=0, lost=len(lost))
    motion, true = (_Motion(*(own[~lost] for own in both)) for both in (motion, _measured(flight, time)))
    cosine = np.abs(np.sum(motion.attitude * true.attitude, axis=1)).clip(max=1.0)
    return RolloutError(
        velocity_m_s=_rms(motion.velocity - true.velocity),
        attitude_deg=float(np.degrees(np.sqrt(np.mean(np.square(2.0 * np.arccos(cosine)))))),
        rates_rad_s=_rms(motion.rates - true.rates),
        starts=int(np.sum(~lost)),
        lost=int(np.sum(lost)),
    )


def _measured(flight: Flight, time: Array) -> _Motion:
    velocity = rotate_body_to_world(flight.attitude, flight.velocity)
    attitude = interpolate_columns(flight.time, flight.attitude, time)
    return _Motion(
        interpolate_columns(flight.time, flight.position, time),
        interpolate_columns(flight.time, velocity, time),
        attitude / np.linalg.norm(attitude, axis=1, keepdims=True),
        interpolate_columns(flight.time, flight.rates, time),
    )


def _slope(vehicle: Vehicle, wrench: Array, motion: _Motion) -> _Motion:
    """Equations of motion: v̇ = R F/m + g, I Ω̇ = M − Ω × IΩ, q̇ = ½ q (0, Ω)."""
    acceleration = rotate_body_to_world(motion.attitude, wrench[:, :3] / vehicle.mass_kg)
    acceleration[:, 2] += vehicle.gravity_m_s2
    moment = wrench[:, 3:] - np.cross(motion.rates, motion.rates @ vehicle.inertia)
    w, x, y, z = motion.attitude.T
    p, q, r = motion.rates.T
    turning = np.stack(
        (-x * p - y * q - z * r, w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p), axis=1
    )
    return _Motion(motion.velocity, acceleration, 0.5 * turning, moment @ np.linalg.inv(vehicle.inertia).T)


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))


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
        rollout=rollouts(flights, [as_it_was(discovery, place) for place in range(len(flights))], after),
        closed_loop=closed_loops(flights, before, after),
        coverage=coverages(flights, base, before, after),
    )


def rollouts(
    flights: Sequence[Flight], before: Sequence[Simulation], after: Sequence[Simulation]
) -> Rollouts:
    """Errors of roll-outs before, after, and with the measured wrench, over all flights.

    There are none where every roll-out of one of the three is lost.
    """
    first = [rollout(flight, simulation) for flight, simulation in zip(flights, before, strict=True)]
    then = [rollout(flight, simulation) for flight, simulation in zip(flights, after, strict=True)]
    floor = [
        rollout_floor(flight, simulation.vehicle) for flight, simulation in zip(flights, after, strict=True)
    ]
    starts = [error.starts for error in first]

    def rms(errors: Sequence[RolloutError], name: str) -> float:
        weights = [error.starts for error in errors]
        return float(np.sqrt(np.average(np.square([getattr(e, name) for e in errors]), weights=weights)))

    judged = all(any(error.starts for error in errors) for errors in (first, then, floor))
    return Rollouts(
        horizon_s=HORIZON_S,
        starts=sum(starts),
        lost={
            when: sum(error.lost for error in errors)
            for when, errors in (("before", first), ("after", then), ("floor", floor))
        },
        errors={
            name: BeforeAfter(rms(first, name), rms(then, name), rms(floor, name))
            for name in RolloutError._fields
            if judged and name not in ("starts", "lost")
        },
    )


def closed_loops(
    flights: Sequence[Flight], before: Simulation, after: Sequence[AugmentedSimulation]
) -> ClosedLoops:
    """Errors of references flown again by the simulation, before and after, against the measured flights.

    Only flights of quadpi's own simulation record their reference. The floor is the error of the estimator,
    known where the bag holds the truth.
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
    """The plan in the bag of a flight; None without a bag, or if the bag is not simulated."""
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
    flights: Sequence[Flight], model: Simulation, before: Simulation, after: Iterable[Simulation]
) -> dict[str, Coverage]:
    """Share of samples inside a model's intervals, per axis, about its predictions before and after.

    Nothing for a simulation without intervals.
    """
    inside = {"before": np.zeros(len(AXES)), "after": np.zeros(len(AXES))}
    samples = 0
    for flight, added in zip(flights, after, strict=True):
        margins = model.margins(flight)
        if margins is None:
            return {}
        lower, upper, _ = margins
        for when, simulation in (("before", before), ("after", added)):
            left = residual(flight, simulation)
            inside[when] += inside_interval(left, lower, upper).sum(axis=0)
        samples += len(flight)
    return {
        axis: Coverage(**{when: float(count[index]) / samples for when, count in inside.items()})
        for index, axis in enumerate(AXES)
    }
