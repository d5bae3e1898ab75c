# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The effects by name: (specimen, size, rng) -> specimen. Size 1 is typical; directions are drawn."""

# Every function of a table takes what all take.
# ruff: noqa: ARG001

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from blind.rotors import WEAK_TORQUE
from blind.sensing import filtered_late, misread, turned_imu
from blind.specimen import Specimen

Alter: TypeAlias = Callable[[Specimen, float, np.random.Generator], Specimen]


def _direction(rng: np.random.Generator, *weights: float) -> np.ndarray:
    """A vector as long as the largest weight, its components weighted; never along one axis alone."""
    sizes = rng.uniform(0.5, 1.0, len(weights)) * rng.choice((-1.0, 1.0), len(weights))
    return np.array(weights) * sizes / np.linalg.norm(sizes)


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


def rotor_drag(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    return s.with_formula("rotor_drag", 0.11 * size)


def body_drag(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    return s.with_formula("body_drag", *(size * np.array([0.0015, 0.0027, 0.0027])), 1.8)


def translational_lift(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    # 0.37 N of the Bebop's 3.67 N at 8 m/s.
    return s.with_formula("translational_lift", 0.105 * size, 0.2)


def inflow_damping(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    return s.with_formula("inflow_damping", 0.33 * size)


def blade_flapping(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    return s.with_formula("blade_flapping", 0.0129 * size, 0.1 * size, 0.02, 0.1)


def ground_effect(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    return s.with_formula("ground_effect", size)


def rotor_interaction(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    return s.with_formula("rotor_interaction", 0.09 * size)


def vortex_ring(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    return s.with_formula("vortex_ring", 0.13 * size)


def rate_damping(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    return s.with_formula("rate_damping", *[2.3e-3 * size] * 3)


def gyroscopic(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    rotor = 8e-6 * size
    return s.with_formula("gyroscopic", rotor).knowing(gyroscopic__rotor_inertia_kg_m2=rotor)


def spin_up(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    rotor = 8e-6 * size
    heavy = s.with_formula("spin_up", rotor).knowing(spin_up__rotor_inertia_kg_m2=rotor)
    return replace(heavy, yaw_authority=1.0 + 23.0 * size)


def thrust_coefficient(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    """Thinner or denser air: everything aerodynamic goes with it."""
    ratio = 1.0 + 0.1 * size * _sign(rng)
    denser = s.with_vehicle(air_density_kg_m3=s.vehicle.air_density_kg_m3 * ratio)
    named = ("rotor_force_along", "rotor_force_across", "rotor_moment_along", "rotor_moment_across")
    denser = denser.with_coefficients(**{name: getattr(s.coefficients, name) * ratio for name in named})
    return denser.knowing(thrust_coefficient__change=ratio - 1.0)


def payload(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    """Hung 15 mm under the centre of gravity, which follows, and the inertia with it."""
    load, arm, mass = 0.05 * size, 0.015, s.vehicle.mass_kg
    turned = load * mass / (load + mass) * arm * arm
    inertia = s.vehicle.inertia + np.diag([turned, turned, 0.0])
    heavier = s.with_vehicle(mass_kg=mass + load, inertia=inertia)
    return heavier.shifted(np.array([0.0, 0.0, arm * load / (load + mass)])).knowing(payload__mass_kg=load)


def cg_offset(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    """The rotors, the airframe and the sensors all sit elsewhere."""
    x, y = 0.005 * size * _direction(rng, 1.0, 1.0)
    return s.shifted(np.array([x, y, 0.0])).knowing(cg_offset__x_m=x, cg_offset__y_m=y)


def inertia(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    """Mass that sits further out, or in, along each arm of the frame."""
    change = 0.2 * size * _sign(rng) * np.array([1.0, rng.uniform(0.8, 1.2), 1.0])
    scale = np.sqrt(1.0 + change)
    known = {f"inertia__{axis}_change": value for axis, value in zip("xyz", change, strict=True)}
    return s.with_vehicle(inertia=s.vehicle.inertia * scale[:, None] * scale).knowing(**known)


def rotor_tilt(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    rotor, towards, lean = rng.integers(4), rng.uniform(-np.pi, np.pi), np.radians(2.0 * size)
    known = {
        "rotor_tilt__rotor": rotor + 1.0,
        "rotor_tilt__forward_deg": np.degrees(np.arcsin(np.sin(lean) * np.cos(towards))),
        "rotor_tilt__right_deg": np.degrees(np.arcsin(np.sin(lean) * np.sin(towards))),
    }
    return s.with_formula("rotor_tilt", rotor, towards, lean).knowing(**known)


def weak_rotor(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    rotor, loss = rng.integers(4), 0.1 * size
    known = {
        "weak_rotor__rotor": rotor + 1.0,
        "weak_rotor__loss": loss,
        "weak_rotor__torque_change": -WEAK_TORQUE * loss,
    }
    return s.with_formula("weak_rotor", rotor, loss).knowing(**known)


def wind(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    """Over a smooth surface: three quarters of it at 0.15 m."""
    from_north = rng.uniform(-np.pi, np.pi)
    return s.with_formula("wind", 2.0 * size * np.cos(from_north), 2.0 * size * np.sin(from_north), 0.0, 0.1)


def force_bias(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    force = 0.1 * np.sqrt(3.0) * size * _direction(rng, 1.0, 1.0, 1.0)
    known = {f"force_bias__{axis}_n": value for axis, value in zip("xyz", force, strict=True)}
    return _with_constant(s, force, np.zeros(3)).knowing(**known)


def moment_bias(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    moment = size * np.sqrt(3.0) * _direction(rng, 0.005, 0.005, 0.002)
    known = {f"moment_bias__{axis}_nm": value for axis, value in zip("xyz", moment, strict=True)}
    return _with_constant(s, np.zeros(3), moment).knowing(**known)


def _with_constant(s: Specimen, force: np.ndarray, moment: np.ndarray) -> Specimen:
    before = np.array(s.formulas.get("constant", np.zeros(6)))
    return s.with_formula("constant", *(before + np.append(force, moment)))


def imu_misalignment(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    angles = np.radians(2.0 * size) * _direction(rng, 1.0, 1.0, 1.0)
    degrees = zip("xyz", np.degrees(angles), strict=True)
    known = {f"imu_misalignment__{axis}_deg": value for axis, value in degrees}
    return s.with_sensor(turned_imu(angles)).knowing(**known)


def sensor_delay(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    """A controller that averages what it sends late."""
    return s.with_sensor(filtered_late(0.006 * size, 0.004 * size))


def rotor_speed_scale(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    change = 0.02 * size * _sign(rng)
    return s.with_sensor(misread(change)).knowing(
        rotor_speed_scale__rotor=0, rotor_speed_scale__change=change
    )


def tether(s: Specimen, size: float, rng: np.random.Generator) -> Specimen:
    """So soft that the flights can be flown: 0.6 N at 8 m."""
    stiffness = 0.1 * size
    line = s.with_formula("tether", stiffness, 2.0, 0.2 * stiffness, 0.0, 0.0, 0.01)
    # Its damping pulls before the line is as long as its length: to the library's law it is shorter.
    return line.knowing(tether__stiffness_n_m=stiffness)


EFFECTS: dict[str, Alter] = {
    alter.__name__: alter
    for alter in (
        *(rotor_drag, body_drag, translational_lift, inflow_damping, blade_flapping, ground_effect),
        *(rotor_interaction, vortex_ring, rate_damping, gyroscopic, spin_up, thrust_coefficient),
        *(payload, cg_offset, inertia, rotor_tilt, weak_rotor, wind, force_bias, moment_bias),
        *(imu_misalignment, sensor_delay, rotor_speed_scale, tether),
    )
}

# That take a second linearisation, hence a larger gap left.
LATE = frozenset({"sensor_delay", "wind"})

# Of no library: as large as the effects that are in it.
OUTSIDE: dict[str, Sequence[float]] = {
    "beat_vibration": (0.25, 0.006),
    "fan_jet": (0.6, 1.5, 0.0, 0.7),
    "jerk_force": (0.012, 0.1),
    "one_sided_drag": (0.06,),
    "lagged_drag": (0.08, 0.4, 0.02),
    "thrust_fade": (0.12,),
    "magnet": (0.02, 5.0),
}


def altered(specimen: Specimen, name: str, size: float, rng: np.random.Generator) -> Specimen:
    """A specimen with an effect of either kind."""
    if name in EFFECTS:
        return EFFECTS[name](specimen, size, rng)
    parameters = OUTSIDE[name]
    return replace(specimen, formulas={**specimen.formulas, name: (parameters[0] * size, *parameters[1:])})
