# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulation of one flight: the truth of a vehicle that flies along a reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core import frames
from quadpi_core.core import inverse, matrix_times
from quadpi_core.errors import SimulationError, VehicleError
from quadpi_core.frames import Array
from quadpi_core.records import record_dtype
from quadpi_core.simulation.applied_effects import (
    added_wind,
    altered_vehicle,
    compose,
    memory_at_rest,
    read_effects,
)
from quadpi_core.simulation.effect_definition import Effects
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.sensor_noise import generator
from quadpi_core.simulation.simulated_aerodynamics import PhysicalAerodynamics, SimulatedAerodynamics
from quadpi_core.simulation.simulated_file import IdentifiedRange, read_simulation
from quadpi_core.simulation.state_records import Controls, Demand, Law, Logged, Memory, Physics, fly
from quadpi_core.simulation.truth import LOG_HZ, STEP_HZ, Reference, Truth, excursion
from quadpi_core.vehicle import Vehicle

# First stamp of every simulated flight: fixed, so that equal plans give equal bytes.
START_NS = 1_700_000_000_000_000_000
_NO_EFFECTS: Effects = {}
LAWS: tuple[type[SimulatedAerodynamics], ...] = (RotorLocalModel, PhysicalAerodynamics)

_NEWTON_STEPS_MAX = 30
# Largest residual of force over weight, and of moment over weight and arm, that counts as trim.
_CONVERGED = 1e-10
# The wind is raised in steps [m/s]; Newton's method starts from the trim of the step before.
_WIND_STEP = 0.5
# Step of the unknowns for central differences.
_DIFFERENCE = 1e-6


@dataclass(frozen=True)
class SimulatedVehicle:
    """Aerodynamics and motors of a vehicle.

    Attributes:
        aerodynamics: its law; holds the vehicle.
        motor_time_constant: time constant [s] of the first-order response of a rotor's speed.
        effects: effects that the vehicle always has.
        identified: ranges of the flights that the aerodynamics were identified on; None where they are not
            known from flights.
    """

    aerodynamics: SimulatedAerodynamics
    motor_time_constant: float
    effects: Effects = field(default_factory=dict)
    identified: IdentifiedRange | None = None

    @classmethod
    def load(cls, name_or_path: str | Path) -> SimulatedVehicle:
        """Read a vehicle by the name of a file in config/vehicles, by path, or from the folder of a model.

        Raises:
            VehicleError: naming the file and the key that is missing, unknown or impossible.
            ModelError: for a folder whose model is no simulation, saying why.
            SimulationError: for effects that are unknown or impossible.
        """
        path, _, section = read_simulation(name_or_path)
        aerodynamics = load_aerodynamics(path)
        if section.motor_time_constant_s is None:
            raise VehicleError(f"{path}: simulation: missing key `motor_time_constant_s`")
        return cls(aerodynamics, section.motor_time_constant_s, own_effects(path), section.identified_range)

    @property
    def vehicle(self) -> Vehicle:
        """Mass, inertia, rotors and sensors."""
        return self.aerodynamics.vehicle

    @property
    def greatest_thrust(self) -> float:
        """Thrust [N] of all rotors at their greatest speed, in still air."""
        vehicle = self.vehicle
        ratio = vehicle.rotor_speed_max_rad_s / self.aerodynamics.hover_rotor_speed
        return float(vehicle.mass_kg * vehicle.gravity_m_s2 * ratio**2)

    def with_own(self, effects: Effects) -> Effects:
        """Effects of a flight and the vehicle; those of the flight replace others of the same name."""
        return {**self.effects, **effects}

    def altered(self, vehicle: Vehicle) -> SimulatedVehicle:
        """The same aerodynamics and motors under another mass and inertia."""
        return replace(self, aerodynamics=self.aerodynamics.carrying(vehicle))

    def record(self) -> npt.NDArray[np.void]:
        """Record VEHICLE (1,) for the compiled physics."""
        return self.aerodynamics.record(self.motor_time_constant)


def load_aerodynamics(name_or_path: str | Path) -> SimulatedAerodynamics:
    """Read the aerodynamics of a vehicle file, or of the folder of a model.

    Raises:
        VehicleError: naming the file and the key that is missing, unknown or impossible, or of which there
            are two.
        ModelError: see :func:`.read_simulation`.
    """
    file = read_simulation(name_or_path)
    given = [law for law in LAWS if getattr(file.section, law.key) is not None]
    if len(given) > 1:
        keys = " and ".join(f"`simulation.{law.key}`" for law in given)
        raise VehicleError(
            f"{file.path}: {keys} exclude each other: a vehicle has one law of its aerodynamics"
        )
    return (given or LAWS)[0].load(name_or_path)


def own_effects(name_or_path: str | Path) -> Effects:
    """The effects that a vehicle file says the vehicle always has: its mapping `simulation.effects`.

    Raises:
        VehicleError: naming the file and the key that is unknown or impossible.
        SimulationError: naming the effect or parameter that is unknown or out of bounds.
    """
    path, _, section = read_simulation(name_or_path)
    return read_effects(section.effects, f"{path}: simulation.effects")


def simulate_flight(
    name: str,
    vehicle: SimulatedVehicle,
    reference: Reference,
    *,
    known_wind: Array | None = None,
    effects: Effects = _NO_EFFECTS,
    extra: Sequence[tuple[Law, Sequence[float]]] = (),
    seed: int = 0,
) -> Truth:
    """Fly a vehicle along a reference, from trim at its first instant.

    The controller knows the vehicle as in its file, without the effects that alter it.

    Args:
        name: name of the flight.
        vehicle: vehicle to fly.
        reference: N instants at STEP_HZ; the flight lasts (N - 1) / STEP_HZ seconds.
        known_wind: (3,) m/s of the world, steady, that an anemometer measures; None for still air.
        effects: effects beside the vehicle's own; those of kind "sensor" do not alter the flight.
        extra: further wrench functions with their parameters, see `applied_effects.compose`.
        seed: seed of gusts.

    Raises:
        SimulationError: naming flight, time and state, if the vehicle gets out of control or to the ground;
            and if it cannot stand still in the wind at the start, or its rotors cannot turn it.
    """
    steps = len(reference)
    every = STEP_HZ // LOG_HZ
    samples = (steps - 1) // every + 1
    if samples < 2:
        raise SimulationError(f"flight {name}: lasts no longer than one sample")
    time = np.arange(steps) / STEP_HZ
    effects = vehicle.with_own(effects)
    if "rotor_thrusts" in effects:
        vehicle.vehicle.require_four("`rotor_thrusts` flies")
    require_rotors(effects, vehicle.vehicle)
    still = np.zeros(3) if known_wind is None else known_wind
    wind = still + added_wind(effects, time, generator(seed, "air"))
    flown = vehicle.altered(altered_vehicle(effects, vehicle.vehicle))
    physics = Physics(
        flown.record(), flown.aerodynamics.function, flown.aerodynamics.numbers, compose(effects, extra)
    )

    start = trim(vehicle.aerodynamics, still, float(reference.yaw[0]))
    memory = Memory.at(reference.position[0], reference.velocity[0], *start, memory_at_rest(effects))
    nominal = vehicle.record()
    # The quantities that coefficients of effects refer to do not change with a payload.
    for hover in ("hover_rotor_speed", "hover_induced_velocity"):
        physics.vehicle[hover] = nominal[hover]
    controls = Controls.from_nominal(nominal, vehicle.aerodynamics.effectiveness)
    if not np.all(np.isfinite(controls.allocation)):
        raise SimulationError(f"vehicle {vehicle.vehicle.name}: its rotors cannot turn it about every axis")
    rotors = vehicle.vehicle.rotor_count
    controls.command[:] = start.rotor_speeds
    log = np.zeros(samples, dtype=record_dtype(Logged, rotors))
    done = np.zeros(1, dtype=np.int64)
    fly(physics, controls, _demand(reference, wind, last=(samples - 1) * every), memory, log, done)
    flown_wind = wind[::every][:samples].copy()
    if done[0] < (samples - 1) * every:
        logged = int(done[0]) // every
        before = excursion(vehicle.identified, vehicle.vehicle, log[:logged], flown_wind[:logged])
        why = "" if before is None else f"; it was {before.sentence()}"
        raise SimulationError(
            f"flight {name}: {_lost(memory.motions[0], reference.position[done[0]], done[0])}{why}"
        )
    return Truth(
        name=name,
        vehicle=flown.vehicle,
        time_ns=START_NS + np.arange(samples) * (1_000_000_000 // LOG_HZ),
        **{column: log[column].copy() for column in log.dtype.names or ()},
        wind=flown_wind,
        known_wind=None if known_wind is None else np.tile(known_wind, (samples, 1)),
        reference=reference.every(every),
        excursion=excursion(vehicle.identified, vehicle.vehicle, log, flown_wind),
    )


def require_rotors(effects: Effects, vehicle: Vehicle) -> None:
    """Refuse an effect on a rotor that a vehicle has not.

    Raises:
        SimulationError: naming effect and rotor.
    """
    for name, values in effects.items():
        rotor = values.get("rotor", 0.0)
        if rotor > vehicle.rotor_count:
            raise SimulationError(
                f"effect `{name}`: rotor {rotor:.0f}, vehicle {vehicle.name} has {vehicle.rotor_count}"
            )


def _demand(reference: Reference, wind: Array, last: int) -> Demand:
    """The reference and wind of the flight, up to the instant `last`."""
    jerk = np.zeros_like(reference.acceleration)
    jerk[:-1] = np.diff(reference.acceleration, axis=0) * STEP_HZ
    columns = (
        reference.position,
        reference.velocity,
        reference.acceleration,
        jerk,
        reference.yaw,
        reference.yaw_rate,
        reference.tilt,
        reference.thrust,
        wind,
    )
    return Demand(*(np.array(column[: last + 1], dtype=float, order="C") for column in columns))


def _lost(motion: np.void, position: Array, step: int) -> str:
    """Message with the time and state at which the vehicle lost control or hit the ground."""
    rotation = frames.matrix(motion["attitude"])
    tilt = np.degrees(np.arccos(np.clip(rotation[2, 2], -1.0, 1.0)))
    rates = ", ".join(f"{rate:.1f}" for rate in motion["rates"])
    speeds = ", ".join(f"{speed:.0f}" for speed in motion["rotor_speeds"])
    what = "hits the ground" if motion["position"][2] > 0.0 else "is out of control"
    return (
        f"the vehicle {what} after {step / STEP_HZ:.3f} s: tilt {tilt:.0f} degrees, "
        f"rates {rates} rad/s, speed {np.linalg.norm(motion['velocity']):.1f} m/s, "
        f"{np.linalg.norm(motion['position'] - position):.1f} m off its reference, rotors {speeds} rad/s"
    )


class Trim(NamedTuple):
    """Attitude (4,) body to world, rotor speeds (rotors,) rad/s."""

    attitude: Array
    rotor_speeds: Array


def trim(model: SimulatedAerodynamics, wind: Array, yaw: float = 0.0) -> Trim:
    """Equilibrium in a wind (3,) m/s of the world, nose at a yaw [rad].

    Newton's method on six unknowns, a tilt about two axes and four rotor speeds, for six equations. Of
    another number of rotors the four are their mean, and what turns the vehicle about each axis.

    Raises:
        SimulationError: if there is none within the limits of the rotors.
    """
    vehicle = model.vehicle
    heading = np.array(frames.from_rotation_vector(np.array([0.0, 0.0, yaw])))
    mixing = _mixing(vehicle)
    unknowns = np.append(np.zeros(2), np.ones(4) if len(mixing) == 4 else (1.0, 0.0, 0.0, 0.0))
    speed = math.sqrt(sum(component * component for component in wind.tolist()))
    steps = max(1, math.ceil(speed / _WIND_STEP))
    for step in range(steps + 1):
        solution = _solve(model, wind * (step / steps), heading, unknowns)
        if solution is None or not np.all(_mixed(mixing, solution[2:]) > 0.0):
            raise SimulationError(f"vehicle {vehicle.name}: cannot stand still in a wind of {speed:.1f} m/s")
        unknowns = solution
    rotor_speeds = _mixed(mixing, unknowns[2:]) * model.hover_rotor_speed
    if rotor_speeds.max() > vehicle.rotor_speed_max_rad_s:
        raise SimulationError(
            f"vehicle {vehicle.name}: to stand still in a wind of {speed:.1f} m/s takes "
            f"{rotor_speeds.max():.0f} rad/s, beyond its {vehicle.rotor_speed_max_rad_s:.0f} rad/s"
        )
    return Trim(_tilted(heading, unknowns), rotor_speeds)


def _mixing(vehicle: Vehicle) -> Array:
    """Speeds (rotors, 4) by each of four unknowns: of four rotors their own."""
    if vehicle.rotor_count == 4:
        return np.eye(4)
    x, y, _ = (vehicle.rotor_positions / np.abs(vehicle.rotor_positions).max()).T
    return np.stack((np.ones_like(x), -y, x, vehicle.rotor_spins), axis=1)


def _mixed(mixing: Array, unknowns: Array) -> Array:
    """Speeds (..., rotors) of unknowns (..., 4), in the same bits on every machine."""
    if len(mixing) == 4:
        return unknowns
    return sum((unknowns[..., k, None] * mixing[:, k] for k in range(1, 4)), unknowns[..., :1])


def _solve(model: SimulatedAerodynamics, wind: Array, heading: Array, start: Array) -> Array | None:
    """Unknowns (6,) at which the accelerations vanish, near a start; None without convergence."""
    unknowns = start.copy()
    for _ in range(_NEWTON_STEPS_MAX):
        probes = np.vstack((unknowns, unknowns + _DIFFERENCE * np.eye(6), unknowns - _DIFFERENCE * np.eye(6)))
        residuals = _unbalance(model, wind, heading, probes)
        if np.abs(residuals[0]).max() < _CONVERGED:
            return unknowns
        jacobian = (residuals[1:7] - residuals[7:]).T / (2.0 * _DIFFERENCE)
        step = matrix_times(inverse(np.ascontiguousarray(jacobian)), residuals[0])
        if not np.all(np.isfinite(step)):
            return None
        unknowns = unknowns - step
    return None


def _unbalance(model: SimulatedAerodynamics, wind: Array, heading: Array, unknowns: Array) -> Array:
    """Residuals (K, 6) of force over weight, and of moment over weight and arm, for unknowns (K, 6)."""
    vehicle = model.vehicle
    turns = np.array([frames.matrix(_tilted(heading, row)) for row in unknowns])
    velocity = np.array([matrix_times(np.ascontiguousarray(turn.T), -wind) for turn in turns])
    rotor_speeds = _mixed(_mixing(vehicle), unknowns[:, 2:]) * model.hover_rotor_speed
    wrench = model.wrench(velocity, np.zeros((len(unknowns), 3)), rotor_speeds)
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    wrench[:, :3] += weight * turns[:, 2, :]
    wrench[:, :3] /= weight
    wrench[:, 3:] /= weight * float(np.abs(vehicle.rotor_positions).max())
    return wrench


def _tilted(heading: Array, unknowns: Array) -> Array:
    tilt = frames.from_rotation_vector(np.array([unknowns[0], unknowns[1], 0.0]))
    return np.array(frames.product(heading, tilt))
