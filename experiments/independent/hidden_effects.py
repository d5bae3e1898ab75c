# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The effects by the name that the library should give, at a size, on an airframe.

An effect changes a :class:`Flown`: RotorPy's parameters, laws that act beside it, air and sensors. Size 1 is
typical; forces grow with the weight, moments with weight times arm. Directions and rotors are drawn.
"""

# Every function of a table takes what all take.
# ruff: noqa: ARG001

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from independent.airframes import Airframe, Array


@dataclass(frozen=True)
class Sensing:
    """What sensors report beside noise.

    Attributes:
        turned: (3,) rad, rotation vector from the IMU's axes to the body's.
        rotor_delay_s: of the rotor speeds.
        rotor_filter_s: time constant of a first-order filter of the rotor speeds.
        rotor_scale: of the reported rotor speeds.
    """

    turned: Array = field(default_factory=lambda: np.zeros(3))
    rotor_delay_s: float = 0.0
    rotor_filter_s: float = 0.0
    rotor_scale: float = 1.0


@dataclass(frozen=True)
class Flown:
    """A vehicle as it truly is.

    Attributes:
        airframe: as its file has it.
        parameters: of RotorPy, as they are.
        centre: (3,) m, of gravity, from where the file has it.
        laws: parameters by the name of a law in `hidden_physics.LAWS`.
        wind_m_s: (2,) at the height of `wind_height_m`, over a rough floor.
        gust_m_s, gust_s: standard deviation and time constant.
        sensing: errors of sensors.
        truth: parameters that the library's effect should have, by `effect.parameter`, where both mean the
            same.
    """

    airframe: Airframe
    parameters: Mapping[str, Any]
    centre: Array = field(default_factory=lambda: np.zeros(3))
    laws: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    wind_m_s: Array = field(default_factory=lambda: np.zeros(2))
    wind_height_m: float = 3.0
    gust_m_s: float = 0.0
    gust_s: float = 1.0
    sensing: Sensing = field(default_factory=Sensing)
    truth: Mapping[str, float] = field(default_factory=dict)

    def with_law(self, name: str, *parameters: float) -> Flown:
        return replace(self, laws={**self.laws, name: tuple(map(float, parameters))})

    def with_parameters(self, **factors: float) -> Flown:
        changed = {name: self.parameters[name] * factor for name, factor in factors.items()}
        return replace(self, parameters={**self.parameters, **changed})

    def knowing(self, **truth: float) -> Flown:
        named = {name.replace("__", "."): float(value) for name, value in truth.items()}
        return replace(self, truth={**self.truth, **named})


# One standard deviation of what no simulation knows better, and the parameters of RotorPy that it scales
# together: as a simulation that is known by its answers alone can state it, by axis and by what the axis
# depends on.
_TOLERANCES = (
    (0.01, ("k_eta",)),
    (0.1, ("k_m",)),
    (0.1, ("k_d", "c_Dx", "c_Dy")),
    (0.1, ("k_z", "k_h", "c_Dz")),
    *((0.02, (name,)) for name in ("Ixx", "Iyy", "Izz")),
)
_CENTRE_M = 0.0003


def ordinary(airframe: Airframe, rng: np.random.Generator, *, each: bool = False) -> Flown:
    """A vehicle as good as its file: every number is off by what its tolerance says.

    Args:
        airframe: as in its file.
        rng: of the draws.
        each: whether every coefficient has a draw of its own, which no simulation can state that is known by
            its answers alone.
    """
    flown = Flown(airframe, airframe.parameters)
    for share, names in _TOLERANCES:
        together = 1.0 + share * rng.standard_normal()
        own = {name: 1.0 + share * rng.standard_normal() if each else together for name in names}
        flown = flown.with_parameters(**own)
    return replace(flown, centre=_CENTRE_M * rng.standard_normal(3))


Alter: TypeAlias = Callable[[Flown, float, np.random.Generator], Flown]


def _direction(rng: np.random.Generator, count: int) -> Array:
    """A vector of length 1, never along one axis alone."""
    sizes = rng.uniform(0.5, 1.0, count) * rng.choice((-1.0, 1.0), count)
    unit: Array = sizes / np.linalg.norm(sizes)
    return unit


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


def _leverage(f: Flown) -> float:
    """Weight times arm, Nm."""
    return f.airframe.weight_n * f.airframe.arm_m


def rotor_drag(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("rotor_drag", 0.03 * size)


def body_drag(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    areas = size * f.airframe.weight_n * np.array([0.0022, 0.003, 0.0035])
    return f.with_law("body_drag", *(areas * (6.0 / f.airframe.speed_m_s) ** 2))


def translational_lift(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("translational_lift", 0.6 * size)


def inflow_damping(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("inflow_damping", 0.07 * size * f.airframe.weight_n)


def blade_flapping(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("blade_flapping", 0.024 * size * _leverage(f))


def ground_effect(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("ground_effect", 1.2 * size)


def rotor_interaction(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("rotor_interaction", 0.15 * size)


def vortex_ring(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("vortex_ring", size)


def rate_damping(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    k = 0.0043 * size * _leverage(f)
    known = {f"rate_damping__{axis}_nm_s": k for axis in "xyz"}
    return f.with_law("rate_damping", k, k, k).knowing(**known)


def _rotor_inertia(f: Flown, size: float) -> float:
    return 1e-3 * size * f.airframe.mass_kg * f.airframe.arm_m**2


def gyroscopic(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    inertia = _rotor_inertia(f, size)
    return f.with_law("gyroscopic", inertia).knowing(gyroscopic__rotor_inertia_kg_m2=inertia)


def spin_up(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    inertia = _rotor_inertia(f, size)
    return f.with_law("spin_up", inertia).knowing(spin_up__rotor_inertia_kg_m2=inertia)


def thrust_coefficient(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    """Denser or thinner air: all that is aerodynamic goes with it."""
    change = 0.1 * size * _sign(rng)
    names = ("k_eta", "k_m", "k_d", "k_z", "k_h", "c_Dx", "c_Dy", "c_Dz")
    denser = f.with_parameters(**dict.fromkeys(names, 1.0 + change))
    return denser.knowing(thrust_coefficient__change=change)


def payload(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    """Hung a tenth of an arm below the centre of gravity, which follows, and the inertia with it."""
    mass = f.airframe.mass_kg
    load, below = 0.134 * size * mass, 0.1 * f.airframe.arm_m
    parallel = load * mass / (load + mass) * below**2
    grown = {name: 1.0 + parallel / f.parameters[name] for name in ("Ixx", "Iyy")}
    heavier = f.with_parameters(mass=1.0 + load / mass, **grown)
    moved = replace(heavier, centre=heavier.centre - np.array([0.0, 0.0, below * load / (load + mass)]))
    return moved.knowing(payload__mass_kg=load)


def cg_offset(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    offset = 0.035 * size * f.airframe.arm_m * _direction(rng, 2)
    moved = replace(f, centre=f.centre + np.append(offset, 0.0))
    # The library has y to the right.
    return moved.knowing(cg_offset__x_m=offset[0], cg_offset__y_m=-offset[1])


def inertia(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    change = 0.2 * size * _sign(rng) * np.array([1.0, rng.uniform(0.8, 1.2), 1.0])
    factors = dict(zip(("Ixx", "Iyy", "Izz"), 1.0 + change, strict=True))
    known = {f"inertia__{axis}_change": value for axis, value in zip("xyz", change, strict=True)}
    return f.with_parameters(**factors).knowing(**known)


def rotor_tilt(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    rotor, heading = int(rng.integers(4)), rng.uniform(-np.pi, np.pi)
    angle = np.radians(2.0 * size)
    known = {
        "rotor_tilt__rotor": rotor + 1.0,
        "rotor_tilt__forward_deg": np.degrees(np.arcsin(np.sin(angle) * np.cos(heading))),
        "rotor_tilt__right_deg": -np.degrees(np.arcsin(np.sin(angle) * np.sin(heading))),
    }
    return f.with_law("rotor_tilt", rotor, heading, angle).knowing(**known)


def weak_rotor(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    rotor, loss = int(rng.integers(4)), 0.1 * size
    known = {
        "weak_rotor__rotor": rotor + 1.0,
        "weak_rotor__loss": loss,
        "weak_rotor__torque_change": -0.6 * loss,
    }
    return f.with_law("weak_rotor", rotor, loss, 0.6 * loss).knowing(**known)


def wind(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    towards = rng.uniform(-np.pi, np.pi)
    blowing = (1.0 + size) * np.array([np.cos(towards), np.sin(towards)])
    return replace(f, wind_m_s=blowing)


def force_bias(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    x, y, z = 0.047 * size * f.airframe.weight_n * _direction(rng, 3)
    return f.with_law("force_bias", x, y, z).knowing(
        force_bias__x_n=x, force_bias__y_n=-y, force_bias__z_n=-z
    )


def moment_bias(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    x, y, z = 0.014 * size * _leverage(f) * _direction(rng, 3) * np.array([1.0, 1.0, 0.5])
    known = {"moment_bias__x_nm": x, "moment_bias__y_nm": -y, "moment_bias__z_nm": -z}
    return f.with_law("moment_bias", x, y, z).knowing(**known)


def imu_misalignment(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    turned = np.radians(2.0 * size) * _direction(rng, 3)
    x, y, z = np.degrees(turned) * np.array([1.0, -1.0, -1.0])
    misaligned = replace(f, sensing=replace(f.sensing, turned=turned))
    return misaligned.knowing(imu_misalignment__x_deg=x, imu_misalignment__y_deg=y, imu_misalignment__z_deg=z)


def sensor_delay(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    """A controller that averages what it sends late."""
    late = replace(f.sensing, rotor_delay_s=0.008 * size, rotor_filter_s=0.004 * size)
    return replace(f, sensing=late)


def rotor_speed_scale(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    change = 0.03 * size * _sign(rng)
    read = replace(f, sensing=replace(f.sensing, rotor_scale=1.0 + change))
    return read.knowing(rotor_speed_scale__rotor=0.0, rotor_speed_scale__change=change)


def tether(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    stiffness = 0.05 * size * f.airframe.weight_n
    return f.with_law("tether", stiffness, 1.0, 0.05 * stiffness).knowing(tether__stiffness_n_m=stiffness)


EFFECTS: dict[str, Alter] = {
    alter.__name__: alter
    for alter in (
        *(rotor_drag, body_drag, translational_lift, inflow_damping, blade_flapping, ground_effect),
        *(rotor_interaction, vortex_ring, rate_damping, gyroscopic, spin_up, thrust_coefficient),
        *(payload, cg_offset, inertia, rotor_tilt, weak_rotor, wind, force_bias, moment_bias),
        *(imu_misalignment, sensor_delay, rotor_speed_scale, tether),
    )
}


def gust(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    """Turbulence, of Dryden's longitudinal spectrum in all directions."""
    return replace(f, gust_m_s=1.5 * size)


def wall(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("wall", 0.15 * size, 0.6 * f.airframe.speed_m_s, 0.8)


def thermal(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("thermal", 0.1 * size, rng.uniform(-0.5, 0.5), 0.4)


def gimbal_scan(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("gimbal_scan", 0.012 * size * _leverage(f), 0.7)


def dragged_cable(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("dragged_cable", 0.05 * size)


def blade_stall(f: Flown, size: float, rng: np.random.Generator) -> Flown:
    return f.with_law("blade_stall", 0.3 * size)


# Forms that no library names, as large as those that it does.
OUTSIDE: dict[str, Alter] = {
    alter.__name__: alter for alter in (gust, wall, thermal, gimbal_scan, dragged_cable, blade_stall)
}
