# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A second source of flights: RotorPy's Hummingbird, of which the simulation has thrust and torque alone.

RotorPy's body axes are forward-left-up, its world is north-west-up. A positive `k_flap` there is nose-down in
forward flight, against what wind tunnels say: here it is negative. Its motor noise comes from a generator
that is global and unseeded: it stays off.
"""

from __future__ import annotations

import importlib.util
import zlib
from collections.abc import Iterable

import numpy as np

from quadpi_core.discrepancy.other_simulations import CallableSimulation
from quadpi_core.estimator.fusion import fuse_airborne
from quadpi_core.flight import Flight
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.simulation.flying import START_NS
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.sensors import sense
from quadpi_core.simulation.truth import LOG_HZ, Reference, Truth
from quadpi_core.vehicle import Vehicle

# Flights of the rich set that RotorPy's controller can follow: it takes position and yaw.
FLIGHTS = ("climb", "forward", "sideways", "coupled", "turns")
# Full size by effect: RotorPy's own Hummingbird; flapping, which it lacks, is that of the Bebop.
EFFECTS = {
    "rotor_drag": {"k_d": 1.19e-4},
    "body_drag": {"c_Dx": 0.5e-2, "c_Dy": 0.5e-2, "c_Dz": 1e-2},
    "inflow_damping": {"k_z": 2.32e-4},
    "translational_lift": {"k_h": 3.39e-3},
    "blade_flapping": {"k_flap": -6.9e-6},
}
OFF = ("k_d", "c_Dx", "c_Dy", "c_Dz", "k_z", "k_h", "k_flap", "motor_noise_std")
_FLIP = np.array([1.0, -1.0, -1.0])


def available() -> bool:
    """Whether RotorPy is installed."""
    return importlib.util.find_spec("rotorpy") is not None


def hummingbird() -> Vehicle:
    """As RotorPy's parameters have it, forward-right-down."""
    from rotorpy.vehicles.hummingbird_params import quad_params as q

    return Vehicle(
        name="hummingbird",
        mass_kg=q["mass"],
        inertia=np.diag([q["Ixx"], q["Iyy"], q["Izz"]]),
        rotor_radius_m=q["rotor_radius"],
        rotor_positions=np.array([position * _FLIP for position in q["rotor_pos"].values()]),
        rotor_spins=q["rotor_directions"].astype(float),
        pole_pairs=7,
        rotor_speed_max_rad_s=float(q["rotor_speed_max"]),
        gravity_m_s2=9.81,
    )


def thrust_and_torque(flight: Flight) -> Array:
    """Wrench (N, 6) of the rotors as in still air: all that the simulation knows."""
    from rotorpy.vehicles.hummingbird_params import quad_params as q

    vehicle, squares = hummingbird(), np.square(flight.rotor_speeds)
    wrench = np.zeros((len(flight), 6))
    wrench[:, 2] = -q["k_eta"] * squares.sum(axis=1)
    wrench[:, 3] = -q["k_eta"] * squares @ vehicle.rotor_positions[:, 1]
    wrench[:, 4] = q["k_eta"] * squares @ vehicle.rotor_positions[:, 0]
    wrench[:, 5] = -q["k_m"] * squares @ vehicle.rotor_spins
    return wrench


def simulation() -> CallableSimulation:
    """To search with."""
    return CallableSimulation("hummingbird", hummingbird(), thrust_and_torque)


def flights_of(
    effects: Iterable[str], plans: Iterable[FlightPlan], suite: SensorSuite, seed: int
) -> list[Flight]:
    """Flights of a Hummingbird that is a little off its parameters and has some of the effects."""
    from rotorpy.vehicles.hummingbird_params import quad_params

    rng = np.random.default_rng(seed)
    parameters = {**quad_params, **dict.fromkeys(OFF, 0.0)}
    for name, deviation in {"k_eta": 0.01, "k_m": 0.1, "Ixx": 0.02, "Iyy": 0.02, "Izz": 0.02}.items():
        parameters[name] *= 1.0 + deviation * rng.standard_normal()
    for name in effects:
        parameters |= EFFECTS[name]
    owned, flights = hummingbird(), []
    for plan in plans:
        if plan.name in FLIGHTS:
            noise = zlib.crc32(f"{seed} {plan.name}".encode())
            sensed = sense(flown(plan, parameters), owned, suite, {}, (), noise)
            flights.append(fuse_airborne(sensed.recording, owned, CUTOFF_HZ["default"]))
    return flights


def flown(plan: FlightPlan, parameters: dict) -> Truth:
    """One flight, stepped as RotorPy's own loop does it."""
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.vehicles.multirotor import Multirotor

    reference, still = plan.reference(LOG_HZ), np.zeros(3)
    hover = np.sqrt(parameters["mass"] * 9.81 / (4.0 * parameters["k_eta"]))
    state = {
        "x": reference.position[0] * _FLIP,
        "v": still,
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": still,
        "wind": still,
        "rotor_speeds": np.full(4, hover),
    }
    # The first step that its solver tries is the whole one: half the time, and errors stay under control.
    solver = {"method": "RK45", "first_step": 1.0 / LOG_HZ}
    vehicle = Multirotor(parameters, initial_state=state, integrator_kwargs=solver)
    controller = SE3Control(parameters)
    states, slopes = [], []
    for k in range(len(reference)):
        command = controller.update(k / LOG_HZ, state, _flat(reference, k))
        slopes.append(vehicle.statedot(state, command, 1.0 / LOG_HZ))
        states.append(state)
        state = vehicle.step(state, command, 1.0 / LOG_HZ)
        if np.linalg.norm(state["x"] - reference.position[k] * _FLIP) > 3.0:
            raise RuntimeError(f"RotorPy loses its path after {k / LOG_HZ:.2f} s of {plan.name}")

    def column(rows: list[dict], name: str) -> Array:
        return np.array([row[name] for row in rows])

    attitude = column(states, "q")[:, [3, 0, 1, 2]] * np.array([1.0, *_FLIP])
    acceleration = column(slopes, "vdot") * _FLIP
    rates, turning = column(states, "w") * _FLIP, column(slopes, "wdot") * _FLIP
    flown = hummingbird()
    inertia = np.diag([parameters["Ixx"], parameters["Iyy"], parameters["Izz"]])
    force = flown.mass_kg * rotate_world_to_body(attitude, acceleration - [0.0, 0.0, flown.gravity_m_s2])
    moment = turning @ inertia + np.cross(rates, rates @ inertia)
    samples = len(reference)
    return Truth(
        name=plan.name,
        vehicle=flown,
        time_ns=START_NS + np.arange(samples) * (1_000_000_000 // LOG_HZ),
        position=column(states, "x") * _FLIP,
        attitude=attitude,
        velocity=rotate_world_to_body(attitude, column(states, "v") * _FLIP),
        rates=rates,
        acceleration=acceleration,
        angular_acceleration=turning,
        rotor_speeds=column(states, "rotor_speeds"),
        rotor_accelerations=np.gradient(column(states, "rotor_speeds"), 1.0 / LOG_HZ, axis=0),
        wrench=np.hstack((force, moment)),
        wind=np.zeros((samples, 3)),
        known_wind=None,
        reference=reference,
    )


def _flat(reference: Reference, k: int) -> dict:
    """Flat outputs as RotorPy's controller takes them."""
    return {
        "x": reference.position[k] * _FLIP,
        "x_dot": reference.velocity[k] * _FLIP,
        "x_ddot": reference.acceleration[k] * _FLIP,
        "yaw": -reference.yaw[k],
        "yaw_dot": -reference.yaw_rate[k],
    }
