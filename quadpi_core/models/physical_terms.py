# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The terms of the physical model: forces and moments of rotors and airframe, one parameter each.

A wrench is Σ parameter · regressor, a regressor being six numbers (force and moment) that follow from the
motion through the air and the rotor speeds. Rotor i at r_i with spin s_i and speed ω sees V + Ω × r_i =
(u, v, w) with h = √(u² + v²) in its plane. Its forces go with ω² R² f(μ, λ) (blade-element theory), so the
regressors are of degree two in ω and V_i, with two of degree three over ω for large advance ratios. v_i is
the induced velocity of momentum theory at the rotor's own thrust.

Sources: Leishman, Principles of Helicopter Aerodynamics (2006), 2.14 (inflow in climb, descent and forward
flight) and 3.5 (thrust, in-plane force and torque of a rotor in forward flight); Mahony, Kumar and Corke,
Multirotor aerial vehicles (2012), on blade flapping and the force in the rotor plane; Bangura and Mahony,
Nonlinear dynamic modeling for high performance control of a quadrotor (2012), on translational lift; Svacha,
Mohta and Kumar, Improving quadrotor trajectory tracking by compensating for aerodynamic effects (2017), on
forces linear in speed; Bauersfeld et al., NeuroBEM (2021), on what blade elements leave out, the wakes of
other rotors above all; Jategaonkar, Flight Vehicle System Identification (2015), on sensor positions and
delays.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import cache
from typing import Annotated, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import ModelError, named_in
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX, PerRotor, Records, record_dtype
from quadpi_core.vehicle import Vehicle

# What a spread is measured in: k R^n with the reference thrust coefficient k [N s²] and rotor radius R, ½ρS
# R^n with the rectangle S of the rotors, weight W, W R, length R, inertia about the vertical.
Scale: TypeAlias = Literal["k/R3", "k/R2", "k/R", "k", "kR", "air", "air R", "air R2", "W", "W R", "R", "I"]


class Term(NamedTuple):
    """A parameter of the physical model.

    Attributes:
        name: of the parameter.
        meaning: of the parameter, in a few words.
        unit: SI.
        group: terms that are chosen or left out together; "" for those that are always there.
        spread: prior standard deviation, in units of `scale`. Set on the NeuroBEM and Crazyflie flights of
            the tests, the fastest included, so that most estimates lie within two of it.
        scale: what it is measured in.
        manoeuvre: that tells it.
        mean: prior mean, in units of `scale`.
        positive: physics does not allow a negative value.
    """

    name: str
    meaning: str
    unit: str
    group: str
    spread: float
    scale: Scale
    manoeuvre: str
    mean: float = 0.0
    positive: bool = False


# The flying that tells a parameter from the others.
_HOVER, _THROTTLE, _CLIMB, _YAW = "hover", "throttle steps", "climbs and descents", "yaw turns"
_FORWARD, _SIDEWAYS = "forward and backward flight", "sideways flight"
_FAST, _FAST_CLIMB = "fast flight in all directions", "fast climbs and descents"
_AGILE, _TURNS, _QUICK = "fast rolls and pitches", "fast turns", "quick changes of rotor speed"
_N0, _N1, _N2, _N3, _M0 = "N s²", "N s²/m", "N s²/m²", "N s²/m³", "Nm s²"

TERMS: tuple[Term, ...] = (
    # Thrust along -z of each rotor, and its moments by the arms.
    Term("thrust", "thrust per ω²", _N0, "", 1.0, "k", _HOVER, 1.0, True),
    Term("thrust_axial", "thrust per ω w: less in climb", _N1, "", 5.0, "k/R", _CLIMB),
    Term("thrust_induced", "thrust lost per ω v_i", _N1, "", 5.0, "k/R", _FAST),
    Term("thrust_axial_square", "thrust per w|w|", _N2, "", 5.0, "k/R2", _FAST_CLIMB),
    Term("thrust_in_plane", "translational lift per h²", _N2, "", 5.0, "k/R2", _FAST),
    Term("thrust_advance", "thrust per ω h", _N1, "", 1.0, "k/R", _FAST),
    Term("thrust_axial_in_plane", "thrust per w h", _N2, "", 15.0, "k/R2", _FAST_CLIMB),
    Term("thrust_axial_induced", "thrust per w v_i", _N2, "", 15.0, "k/R2", _FAST_CLIMB),
    Term("thrust_axial_even", "thrust per w²", _N2, "", 5.0, "k/R2", _FAST_CLIMB),
    Term("thrust_in_plane_cubed", "thrust per h³/ω", _N3, "high advance", 30.0, "k/R3", _FAST),
    Term("thrust_mixed_cubed", "thrust per h w²/ω", _N3, "high advance", 30.0, "k/R3", _FAST_CLIMB),
    Term("thrust_incline_x", "per ω u: rotor planes inclined", _N1, "incline", 0.05, "k/R", _FORWARD),
    Term("thrust_incline_y", "per ω v: rotor planes inclined", _N1, "incline", 0.05, "k/R", _SIDEWAYS),
    Term("thrust_rotor_1", "thrust of rotor 1 over that of 4, per ω²", _N0, "rotors", 0.05, "k", _AGILE),
    Term("thrust_rotor_2", "thrust of rotor 2 over that of 4, per ω²", _N0, "rotors", 0.05, "k", _AGILE),
    Term("thrust_rotor_3", "thrust of rotor 3 over that of 4, per ω²", _N0, "rotors", 0.05, "k", _AGILE),
    # Moments of thrust by the arms differ: the flow is not uniform, and arms are not those of the file.
    Term("arm_thrust", "moment of thrust per ω² beside the arms", _N0, "", 0.3, "k", _AGILE),
    Term("arm_x", "moment about y per ω² beside the arms", _N0, "", 0.3, "k", _AGILE),
    Term("arm_axial", "moment of thrust per ω w", _N1, "arms", 3.0, "k/R", _CLIMB),
    Term("arm_induced", "moment of thrust per ω v_i", _N1, "arms", 3.0, "k/R", _FAST),
    Term("arm_in_plane", "moment of thrust per h²", _N2, "arms", 5.0, "k/R2", _FAST),
    Term("arm_advance", "moment of thrust per ω h", _N1, "arms", 1.0, "k/R", _FAST),
    Term("arm_axial_in_plane", "moment of thrust per w h", _N2, "arms", 5.0, "k/R2", _FAST_CLIMB),
    # Rotors in the wake of others lose thrust; the airframe takes up the moment.
    Term("wake_x", "thrust per ω u, front less rear", _N1, "wakes", 5.0, "k/R", _FORWARD),
    Term("wake_y", "thrust per ω v, right less left", _N1, "wakes", 5.0, "k/R", _SIDEWAYS),
    Term("wake_axial_x", "thrust per w u, front less rear", _N2, "wakes", 20.0, "k/R2", _AGILE),
    Term("wake_axial_y", "thrust per w v, right less left", _N2, "wakes", 20.0, "k/R2", _AGILE),
    Term("thrust_forward", "thrust per ω|u|, beside its moments", _N1, "wakes", 1.0, "k/R", _FORWARD),
    Term("thrust_sideways", "thrust per ω|v|, beside its moments", _N1, "wakes", 1.0, "k/R", _SIDEWAYS),
    Term("wake_moment_x", "moment of it per ω u, front less rear", _N1, "wakes", 0.5, "k/R", _FORWARD),
    Term("wake_moment_y", "moment of it per ω v, right less left", _N1, "wakes", 0.5, "k/R", _SIDEWAYS),
    # Torque of each rotor.
    Term("torque", "torque per ω²", _M0, "", 0.3, "kR", _YAW, 0.2, True),
    Term("torque_axial", "torque per ω w", _N0, "torque", 0.5, "k", _CLIMB),
    Term("torque_induced", "torque per ω v_i", _N0, "torque", 0.5, "k", _FAST),
    Term("torque_advance", "torque per ω h", _N0, "torque", 0.5, "k", _FAST),
    Term("torque_rotor_1", "torque of rotor 1 over that of 4, per ω²", _M0, "rotors", 0.005, "kR", _AGILE),
    Term("torque_rotor_2", "torque of rotor 2 over that of 4, per ω²", _M0, "rotors", 0.005, "kR", _AGILE),
    Term("torque_rotor_3", "torque of rotor 3 over that of 4, per ω²", _M0, "rotors", 0.005, "kR", _AGILE),
    # Force in the rotor plane, along and across its motion, with the yaw moment by the arms.
    Term("rotor_drag", "force along -(u, v) per ω", _N1, "", 1.0, "k/R", _FORWARD),
    Term("rotor_drag_advance", "force along -(u, v) per h", _N2, "rotor drag", 10.0, "k/R2", _FAST),
    Term("rotor_drag_axial", "force along -(u, v) per w", _N2, "rotor drag", 2.0, "k/R2", _FAST_CLIMB),
    Term("rotor_drag_induced", "force along -(u, v) per v_i", _N2, "rotor drag", 2.0, "k/R2", _FAST),
    Term("rotor_side", "force across (u, v) per ω", _N1, "rotor side", 0.5, "k/R", _YAW),
    Term("rotor_side_advance", "force across (u, v) per h", _N2, "rotor side", 1.0, "k/R2", _FAST),
    Term("rotor_side_axial", "force across (u, v) per w", _N2, "rotor side", 1.0, "k/R2", _FAST_CLIMB),
    Term("rotor_side_induced", "force across (u, v) per v_i", _N2, "rotor side", 1.0, "k/R2", _FAST),
    # Moments at the hub: flapping and the height of the rotor plane above the centre of gravity.
    Term("hub_height", "moment of the force along, per ω", _N0, "", 1.5, "k", _FORWARD),
    Term("hub_height_advance", "moment of the force along, per h", _N1, "hub", 1.0, "k/R", _FAST),
    Term("hub_height_induced", "moment of the force along, per v_i", _N1, "hub", 1.0, "k/R", _FAST),
    Term("hub_roll", "moment along (u, v) times spin, per ω", _N0, "hub", 0.5, "k", _FAST),
    Term("hub_roll_induced", "moment along (u, v) times spin, per v_i", _N1, "hub", 1.0, "k/R", _FAST),
    # The airframe in the flow of the rotors, and in its own.
    Term("body_x_speed", "force x per mean ω u", _N1, "body in wake", 4.0, "k/R", _FORWARD),
    Term("body_y_speed", "force y per mean ω v", _N1, "body in wake", 4.0, "k/R", _SIDEWAYS),
    Term("body_x_induced", "force x per v_i u", _N2, "body in wake", 1.0, "air", _FORWARD),
    Term("body_y_induced", "force y per v_i v", _N2, "body in wake", 1.0, "air", _SIDEWAYS),
    Term("body_x_cross", "force x per mean ω v", _N1, "cross flow", 1.0, "k/R", _SIDEWAYS),
    Term("body_y_cross", "force y per mean ω u", _N1, "cross flow", 1.0, "k/R", _FORWARD),
    Term("body_x_downwash", "force x per v_i w", _N2, "downwash", 0.2, "air", _CLIMB),
    Term("body_y_downwash", "force y per v_i w", _N2, "downwash", 0.2, "air", _CLIMB),
    Term("body_roll_downwash", "moment x per v_i w", _N1, "downwash", 0.4, "air R", _CLIMB),
    Term("body_pitch_downwash", "moment y per v_i w", _N1, "downwash", 0.4, "air R", _CLIMB),
    Term("drag_x", "force along -x per u|u|", _N2, "drag", 2.0, "air", _FORWARD),
    Term("drag_y", "force along -y per v|v|", _N2, "drag", 2.0, "air", _SIDEWAYS),
    Term("drag_z", "force along -z per w|w|", _N2, "drag", 2.0, "air", _FAST_CLIMB),
    Term("drag_x_speed", "force along -x per u|V|", _N2, "drag", 2.0, "air", _FORWARD),
    Term("drag_y_speed", "force along -y per v|V|", _N2, "drag", 2.0, "air", _SIDEWAYS),
    Term("drag_z_speed", "force along -z per w|V|", _N2, "drag", 2.0, "air", _FAST_CLIMB),
    Term("lift_w_u", "force along -z per w|u|", _N2, "lift", 2.0, "air", _FORWARD),
    Term("lift_w_v", "force along -z per w|v|", _N2, "lift", 2.0, "air", _SIDEWAYS),
    Term("lift_x", "force x per u w", _N2, "lift", 4.0, "air", _FORWARD),
    Term("lift_y", "force y per v w", _N2, "lift", 4.0, "air", _SIDEWAYS),
    Term("pitch_u", "moment y per u|V|", _N1, "body moment", 1.5, "air R", _FORWARD),
    Term("pitch_uw", "moment y per u w", _N1, "body moment", 1.5, "air R", _FORWARD),
    Term("roll_v", "moment x per v|V|", _N1, "body moment", 1.5, "air R", _SIDEWAYS),
    Term("roll_vw", "moment x per v w", _N1, "body moment", 1.5, "air R", _SIDEWAYS),
    Term("yaw_uv", "moment z per u v", _N1, "body moment", 1.5, "air R", _FAST),
    Term("yaw_v", "moment z per v|V|", _N1, "body moment", 1.5, "air R", _SIDEWAYS),
    # Damping, inertia of the rotors, products of inertia.
    Term("damping_p", "moment along -p per |V|", _N0, "damping", 5.0, "air R2", _AGILE),
    Term("damping_q", "moment along -q per |V|", _N0, "damping", 5.0, "air R2", _AGILE),
    Term("damping_r", "moment along -r per |V|", _N0, "damping", 5.0, "air R2", _YAW),
    Term("rotor_inertia_gyro", "rotor inertia by its gyroscopic moment", "kg m²", "spin", 3e-3, "I", _AGILE),
    Term("rotor_inertia_spin", "rotor inertia while it speeds up", "kg m²", "spin", 3e-3, "I", _QUICK),
    Term("inertia_x", "error of (I_z - I_y), by q r", "kg m²", "inertia", 0.1, "I", _TURNS),
    Term("inertia_y", "error of (I_x - I_z), by r p", "kg m²", "inertia", 0.1, "I", _TURNS),
    Term("inertia_z", "error of (I_y - I_x), by p q", "kg m²", "inertia", 0.1, "I", _TURNS),
    # Sensors and mounting.
    Term("bias_x", "force x at rest", "N", "", 0.005, "W", _THROTTLE),
    Term("bias_y", "force y at rest", "N", "", 0.005, "W", _THROTTLE),
    Term("bias_z", "force z at rest", "N", "", 0.005, "W", _THROTTLE),
    Term("bias_roll", "moment x at rest", "Nm", "", 0.02, "W R", _THROTTLE),
    Term("bias_pitch", "moment y at rest", "Nm", "", 0.02, "W R", _THROTTLE),
    Term("bias_yaw", "moment z at rest", "Nm", "", 0.02, "W R", _THROTTLE),
    Term("incline_x", "force x per ω²: IMU inclined", _N0, "", 0.03, "k", _THROTTLE),
    Term("incline_y", "force y per ω²: IMU inclined", _N0, "", 0.03, "k", _THROTTLE),
    Term("gravity_centre_x", "moment y per ω²: CG off x", _M0, "", 0.05, "kR", _THROTTLE),
    Term("gravity_centre_y", "moment x per ω²: CG off y", _M0, "", 0.05, "kR", _THROTTLE),
    Term("imu_x", "x of the accelerometer from the CG", "m", "imu position", 0.3, "R", _AGILE),
    Term("imu_y", "y of the accelerometer from the CG", "m", "imu position", 0.3, "R", _AGILE),
    Term("imu_z", "z of the accelerometer from the CG", "m", "imu position", 0.3, "R", _AGILE),
)  # fmt: skip
# Manoeuvres whose speed tells terms apart that grow with another power of it.
BY_SPEED = frozenset({_CLIMB, _FAST, _FAST_CLIMB, _FORWARD, _SIDEWAYS})
TERM_NAMES = tuple(term.name for term in TERMS)
TERM_INDEX = {name: index for index, name in enumerate(TERM_NAMES)}


def scales(vehicle: Vehicle, reference_thrust: float) -> Array:
    """Value (P,) in SI units of the scale of each term."""
    k, radius = reference_thrust, vehicle.rotor_radius_m
    half_length, half_width, _ = np.abs(vehicle.rotor_positions).mean(axis=0)
    air = 2.0 * vehicle.air_density_kg_m3 * half_length * half_width
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    values: dict[Scale, float] = {
        "k/R3": k / radius**3,
        "k/R2": k / radius**2,
        "k/R": k / radius,
        "k": k,
        "kR": k * radius,
        "air": air,
        "air R": air * radius,
        "air R2": air * radius**2,
        "W": weight,
        "W R": weight * radius,
        "R": radius,
        "I": float(vehicle.inertia[2, 2]),
    }
    return np.array([values[term.scale] for term in TERMS])


# A parameter whose standard error is this share of its prior spread was not identified by the flights.
UNKNOWN = 0.9
# A parameter whose standard error were this share of its prior spread, if all others were known, is excited.
_EXCITED = 0.5
# Correlation beyond which a parameter is said to look like another.
_ALIKE = 0.5
# The delay of rotor speeds [s] that is used where flights do not tell it: none, as of a log whose stamps are
# those of the rotors. They do not where delays that differ by so much [s], this one among them, remain: the
# data sets of the tests have delays of 2.5 to 7.5 ms, told within 5 ms.
UNTOLD_DELAY_S, _UNTOLD_RANGE_S = 0.0, 0.01
# Least variance of a direction of parameters, in units of the prior: rounding may leave less than none.
_LEAST_VARIANCE = 1e-12


def unidentified(covariance: Array, spreads: Array) -> dict[str, str]:
    """Notes on parameters that flights did not identify beyond their prior: which manoeuvre would.

    Args:
        covariance: (P, P) of the posterior; zero where a term was left out.
        spreads: (P,) of the prior.
    """
    fitted = np.flatnonzero(np.diag(covariance) > 0.0)
    if not len(fitted):
        return {}
    correlation = covariance[np.ix_(fitted, fitted)] / np.outer(spreads[fitted], spreads[fitted])
    share = np.sqrt(np.diag(correlation))
    # Standard error of each if all others were known: far smaller where flights excite it.
    values, vectors = np.linalg.eigh(correlation)
    alone = 1.0 / np.sqrt(np.square(vectors) @ (1.0 / np.maximum(values, _LEAST_VARIANCE)))
    alike = np.abs(correlation / np.outer(share, share)) - np.eye(len(fitted))
    notes = {}
    for k in np.flatnonzero(share > UNKNOWN):
        term, other = TERMS[fitted[k]], int(np.argmax(alike[k]))
        note = "not identified by these flights"
        excited = alone[k] <= _EXCITED
        if excited and alike[k, other] > _ALIKE:
            note += f", which hardly tell it from {TERM_NAMES[fitted[other]]}"
        speeds = " at several speeds" if excited and term.manoeuvre in BY_SPEED else ""
        notes[term.name] = f"{note}: fly {term.manoeuvre}{speeds}"
    return notes


def missing_flying(names: Iterable[str], count: int) -> str:
    """A sentence on what to fly for parameters that were not identified; empty where all were.

    Args:
        names: of these parameters.
        count: of the parameters in the model.
    """
    manoeuvres = Counter(TERMS[TERM_INDEX[name]].manoeuvre for name in names)
    if not manoeuvres:
        return ""
    words = ", ".join(f"{manoeuvre} ({number})" for manoeuvre, number in manoeuvres.most_common())
    return (
        f"{manoeuvres.total()} of {count} parameters are not identified by these flights; "
        f"what would tell them, and how many: {words}"
    )


def delay_untold(range_s: tuple[float, float]) -> bool:
    """Whether the range of delays [s] that flights do not rule out is too wide to state one."""
    low, high = range_s
    return low <= UNTOLD_DELAY_S and high - low >= _UNTOLD_RANGE_S


def delay_words(delay_s: float, range_s: tuple[float, float] | None, longest_s: float) -> str:
    """Sentence on the identified delay of the rotor speeds, and the range that flights do not rule out.

    Args:
        delay_s: that is used.
        range_s: delays that the flights do not rule out; None where it was not kept.
        longest_s: delay that was tried.
    """
    words = f"rotor speeds act {delay_s * 1e3:g} ms after they were measured"
    low, high = (bound * 1e3 for bound in range_s or (delay_s, delay_s))
    longer = ", or later: no longer delay is tried" if high >= longest_s * 1e3 else ""
    if range_s is not None and delay_untold(range_s):
        return (
            f"rotor speeds are taken to act {delay_s * 1e3:g} ms after they were measured, as these flights "
            f"do not tell delays of {low:g} to {high:g} ms apart: fly fast rolls and pitches"
        )
    return words + (f" ({low:g} to {high:g} ms{longer})" if high > low else longer)


# Rotor i at r_i with spin s_i and speed ω sees V + Ω × r_i = (u, v, w), with h = √(u² + v²) in its plane and
# its own induced velocity v_i; `physical_terms` says what each term means and where it comes from.


class MotionSample:
    """What the regressors of a sample follow from; SI, body axes.

    Attributes:
        velocity: m/s relative to the air.
        rates: rad/s.
        angular_acceleration: rad/s².
        rotor_speeds: rad/s.
        rotor_accelerations: rad/s².
    """

    velocity: Annotated[Array, 3]
    rates: Annotated[Array, 3]
    angular_acceleration: Annotated[Array, 3]
    rotor_speeds: PerRotor
    rotor_accelerations: PerRotor


class PhysicalVehicle:
    """The numbers of a vehicle that the regressors need.

    Attributes:
        mass: kg.
        reference_thrust: N s², of a rotor per ω², for the induced velocity.
        disc: kg/m, 2 ρ π R² of momentum theory.
        rotors: their number.
        positions: m, of the rotors.
        spins: +1 where a rotor turns clockwise seen from above.
    """

    mass: float
    reference_thrust: float
    disc: float
    rotors: int
    positions: Annotated[Array, ROTORS_MAX, 3]
    spins: PerRotor


# Of four rotors.
MOTION = record_dtype(MotionSample, 4)
PHYSICAL_VEHICLE = record_dtype(PhysicalVehicle, 4)


def physical_vehicle(vehicle: Vehicle, reference_thrust: float) -> Records:
    """Record PHYSICAL_VEHICLE (1,) of a vehicle.

    Args:
        vehicle: that flew.
        reference_thrust: [N s²] thrust of a rotor over ω², near hover.

    Raises:
        ModelError: naming the vehicle, see :func:`control_signs`.
    """
    record = numbers_of(vehicle, reference_thrust)
    with named_in(f"vehicle {vehicle.name}"):
        control_signs(record)
    return record


def numbers_of(vehicle: Vehicle, reference_thrust: float) -> Records:
    """Record PHYSICAL_VEHICLE (1,) as `physical_vehicle` gives it, for any layout of the rotors."""
    record = np.zeros(1, record_dtype(PhysicalVehicle, vehicle.rotor_count))
    record["rotors"] = vehicle.rotor_count
    record["mass"] = vehicle.mass_kg
    record["reference_thrust"] = reference_thrust
    record["disc"] = 2.0 * vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**2
    record["positions"] = vehicle.rotor_positions
    record["spins"] = vehicle.rotor_spins
    return record


def control_signs(vehicle: Records) -> Array:
    """Signs (3, rotors) that give U_p, U_q and U_r of the rotor speeds, see `inputs.vehicle_constants`.

    Raises:
        ModelError: where the rotor speeds of four rotors do not follow from these and their root mean square.
    """
    positions, spins = vehicle["positions"][0], vehicle["spins"][0]
    signs: Array = np.stack((-np.sign(positions[:, 1]), np.sign(positions[:, 0]), spins))
    every = np.vstack((np.ones(len(spins)), signs))
    if len(spins) == 4 and signs.all() and not np.array_equal(every @ every.T, 4.0 * np.eye(4)):
        raise ModelError(
            "the physical model needs a rotor in each quadrant, neighbours turning in opposite ways"
        )
    return signs


@cache
def acting_terms() -> npt.NDArray[np.bool_]:
    """Which axes (P, 6) each term acts on, for a vehicle without any symmetry."""
    motion = np.zeros(2, MOTION)
    motion["velocity"] = [[3.0, 2.0, 1.0], [-1.0, 2.0, -3.0]]
    motion["rates"] = [[0.3, 0.2, 0.1], [0.1, -0.2, 0.3]]
    motion["angular_acceleration"] = [1.0, 2.0, 3.0]
    motion["rotor_speeds"] = [900.0, 1000.0, 1100.0, 1250.0]
    motion["rotor_accelerations"] = [1.0, 2.0, 4.0, 8.0]
    vehicle = np.zeros(1, PHYSICAL_VEHICLE)
    vehicle["mass"], vehicle["reference_thrust"], vehicle["disc"] = 1.0, 1e-6, 0.1
    vehicle["positions"] = [[-0.1, 0.11, 0.0], [0.12, 0.13, 0.0], [-0.14, -0.15, 0.0], [0.16, -0.17, 0.0]]
    vehicle["spins"], vehicle["rotors"] = [1.0, -1.0, -1.0, 1.0], 4
    return np.any(regressors(motion, vehicle) != 0.0, axis=0)


def regressors(motion: Records, vehicle: Records) -> Array:
    """Regressors (N, P, 6) of samples, the terms in the order of TERMS.

    Args:
        motion: MOTION (N,).
        vehicle: PHYSICAL_VEHICLE (1,).
    """
    rows = np.empty((len(motion), len(TERMS), len(AXES)))
    compiled.fill_regressors(_whole(motion, vehicle), vehicle, rows)
    return rows


def wrenches(motion: Records, vehicle: Records, parameters: Array) -> Array:
    """Wrench (N, 6) of samples, by parameters (P,) in the order of TERMS."""
    out = np.empty((len(motion), len(AXES)))
    compiled.physical_wrenches(_whole(motion, vehicle), vehicle, np.ascontiguousarray(parameters), out)
    return out


def _whole(motion: Records, vehicle: Records) -> Records:
    """Motion with room for more rotors, which what numpy has joined lacks."""
    return np.ascontiguousarray(motion, record_dtype(MotionSample, int(vehicle["rotors"][0])))
