# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is hidden: laws of the literature as functions of RotorPy's state, independent of the library's.

Each takes a :class:`Moment` and its parameters and gives force [N] and moment [Nm] about the centre of
gravity, body axes forward-left-up, beyond what RotorPy computes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from independent.airframes import Airframe, Array, Blades

Wrench: TypeAlias = tuple[Array, Array]
_ZERO = np.zeros(3)
UP = np.array([0.0, 0.0, 1.0])


def crosses(vector: Array, rows: Array) -> Array:
    """A vector (3,) times each of the rows (N, 3)."""
    p, q, r = vector.tolist()
    return np.array([(q * z - r * y, r * x - p * z, p * y - q * x) for x, y, z in rows.tolist()])


def sum_of_crosses(one: Array, other: Array) -> Array:
    """Sum of the products of rows (N, 3)."""
    p = q = r = 0.0
    for (x, y, z), (u, v, w) in zip(one.tolist(), other.tolist(), strict=True):
        p, q, r = p + (y * w - z * v), q + (z * u - x * w), r + (x * v - y * u)
    return np.array([p, q, r])


@dataclass
class Moment:
    """One evaluation of the equations of motion.

    Attributes:
        airframe: as in its file.
        blades: of its rotors.
        rotors: (4, 3) from the true centre of gravity.
        thrust_n: (4,) at these rotor speeds in still air.
        time_s: since the start of the flight.
        position: of the true centre of gravity, m.
        rotation: body to world (3, 3).
        velocity: over ground, world axes.
        airspeed: body axes.
        rates: body axes.
        speeds, spin_ups: of the rotors, rad/s and rad/s².
        memory: of the flight, by name: `phase` of what begins by itself.
    """

    airframe: Airframe
    blades: Blades
    rotors: Array
    thrust_n: Array
    time_s: float
    position: Array
    rotation: Array
    velocity: Array
    airspeed: Array
    rates: Array
    speeds: Array
    spin_ups: Array
    memory: dict[str, Any] = field(default_factory=dict)

    @property
    def hub_airspeed(self) -> Array:
        """(4, 3) of the rotors."""
        return self.airspeed + crosses(self.rates, self.rotors)

    @property
    def tip_speeds(self) -> Array:
        return np.maximum(self.speeds, 1.0) * self.airframe.radius_m

    def at_hubs(self, forces: Array) -> Wrench:
        """Forces (4, 3) that act at the hubs."""
        return forces.sum(axis=0), sum_of_crosses(self.rotors, forces)

    def thrusts(self, gained: Array) -> Wrench:
        """Thrusts (4,) gained along the shafts."""
        forces = np.zeros((4, 3))
        forces[:, 2] = gained
        return self.at_hubs(forces)

    def in_body(self, force: Array) -> Array:
        turned: Array = self.rotation.T @ force
        return turned


def _flow(m: Moment) -> tuple[Array, Array, Array]:
    """Airspeed in the rotors' planes (4, 2), advance ratio (4,) and climb over tip speed (4,)."""
    hub, tip = m.hub_airspeed, m.tip_speeds
    plane = hub[:, :2]
    return plane, np.hypot(plane[:, 0], plane[:, 1]) / tip, hub[:, 2] / tip


def _tilt_slope(blades: Blades, inflow: Array | float) -> Array | float:
    """Backward tilt of the disc over advance ratio of blades that flap freely.

    a1s = μ (8/3 θ − 2 λ) with λ down through the disc, which lowers the angle of attack:
    Bramwell's Helicopter Dynamics (2001), section 3.8; μ²/2 is below a hundredth and left out.
    """
    return 8.0 / 3.0 * blades.pitch - 2.0 * inflow


def rotor_drag(m: Moment, per_m_s: float) -> Wrench:
    """Thrust that leans back with the disc, share of it per m/s of edgewise airspeed in hover.

    Mahony, Kumar and Corke, Multirotor Aerial Vehicles, IEEE Robot. Autom. Mag. 19 (2012), equation 9.
    """
    plane, advance, climb = _flow(m)
    blades = m.blades
    thrust, inflow = blades.state(advance, climb)
    hover = _tilt_slope(blades, blades.inflow)
    lean = per_m_s * np.asarray(_tilt_slope(blades, inflow)) / hover * m.airframe.hover_rad_s / m.speeds
    true = m.thrust_n * thrust / blades.hover_thrust
    forces = np.zeros((4, 3))
    forces[:, :2] = -(true * lean)[:, None] * plane
    return m.at_hubs(forces)


def blade_flapping(m: Moment, nm_s_m: float) -> Wrench:
    """Hub moment of stiff blades: the nose rises in forward flight, and a tenth of it goes sideways.

    Hub moment in proportion to the flapping angles; lateral flapping b1s from coning and inflow gradient is a
    share of a1s: Hoffmann, Huang, Waslander and Tomlin, Precision flight control for a multi-vehicle
    quadrotor helicopter testbed, Control Eng. Pract. 19 (2011), section 3.3.
    """
    plane, advance, climb = _flow(m)
    blades = m.blades
    _, inflow = blades.state(advance, climb)
    slope = np.asarray(_tilt_slope(blades, inflow)) / _tilt_slope(blades, blades.inflow)
    # Flapping angle goes with V / ωR, the centrifugal part of the stiffness with ω².
    k = 0.25 * nm_s_m * slope * m.speeds / m.airframe.hover_rad_s
    u, v = plane.T
    spin = np.asarray(m.airframe.parameters["rotor_directions"])
    mx = k * (v + 0.1 * spin * u)
    my = k * (-u + 0.1 * spin * v)
    return _ZERO, np.array([mx.sum(), my.sum(), 0.0])


def body_drag(m: Moment, cx: float, cy: float, cz: float) -> Wrench:
    """Drag areas of a frame's three views, axis by axis: Hoerner, Fluid-Dynamic Drag (1965), chapter 3."""
    return -np.array([cx, cy, cz]) * np.abs(m.airspeed) * m.airspeed, _ZERO


def translational_lift(m: Moment, share: float) -> Wrench:
    """Thrust that rotors gain in edgewise flow, a share of what blade elements in Glauert's inflow gain."""
    _, advance, climb = _flow(m)
    gained = m.blades.state(advance, climb)[0] - m.blades.state(np.zeros(4), climb)[0]
    return m.thrusts(share * m.thrust_n * gained / m.blades.hover_thrust)


def inflow_damping(m: Moment, n_s_m: float) -> Wrench:
    """Thrust lost in climb, of blade elements in the inflow of momentum theory, by its slope in hover."""
    _, _, climb = _flow(m)
    lost = m.blades.state(np.zeros(4), climb)[0] - m.blades.hover_thrust
    step = np.full(4, 1e-3)
    slope = (m.blades.hover_thrust - m.blades.state(np.zeros(4), step)[0][0]) / 1e-3
    tip = m.airframe.hover_rad_s * m.airframe.radius_m
    # Of all four at hover: d thrust / d climb = weight slope / (thrust coefficient × tip speed).
    natural = m.airframe.weight_n * slope / (m.blades.hover_thrust * tip)
    return m.thrusts(n_s_m / natural * m.thrust_n * lost / m.blades.hover_thrust)


def ground_effect(m: Moment, strength: float) -> Wrench:
    """Thrust at constant power near the ground, by each rotor's height.

    P/P∞ = 1/(0.9926 + 0.0379 (2R/z)²) and T/T∞ = (P∞/P)^⅔: Hayden, The effect of the ground on helicopter
    hovering power required, AHS Forum 32 (1976). It fades with the skew of the wake as in Cheeseman and
    Bennett.
    """
    height = np.maximum(m.position[2] + (m.rotors @ m.rotation.T)[:, 2], 0.5 * m.airframe.radius_m)
    ratio = 2.0 * m.airframe.radius_m / height
    gain = (0.9926 + 0.0379 * ratio**2) ** (2.0 / 3.0) - 0.9926 ** (2.0 / 3.0)
    plane, _, _ = _flow(m)
    skew = 1.0 / (1.0 + (plane**2).sum(axis=1) / m.airframe.hover_inflow_m_s**2)
    return m.thrusts(strength * gain * skew * m.thrust_n)


def rotor_interaction(m: Moment, loss: float) -> Wrench:
    """Rotors behind others fly in their wake, which the airspeed bends into the plane of the rotors.

    Loss with the sine of the wake's skew angle and with how well two rotors are in line: after the wake
    overlap of Bangura, Aerodynamics and Control of Quadrotors (PhD thesis, ANU, 2017), chapter 4.
    """
    u, v = m.airspeed[:2]
    speed = float(np.hypot(u, v))
    if speed < 1e-6:
        return _ZERO, _ZERO
    ahead = np.array([u, v]) / speed
    skew = speed / np.hypot(speed, m.airframe.hover_inflow_m_s)
    lost = np.zeros(4)
    for rear in range(4):
        for front in range(4):
            gap = (m.rotors[front] - m.rotors[rear])[:2]
            along = float(gap @ ahead)
            if front == rear or along <= 0.0:
                continue
            aside = float(np.hypot(*(gap - along * ahead))) / m.airframe.radius_m
            lost[rear] += np.exp(-0.5 * aside**2) * along / np.hypot(*gap)
    return m.thrusts(-loss * skew * lost * m.thrust_n)


def vortex_ring(m: Moment, share: float) -> Wrench:
    """Thrust lost in descent, as measured induced velocities exceed those of momentum theory's climb branch.

    v/v_h = 1 − V/v_h down to −1.5, 7 + 3 V/v_h beyond: Young, Theory and practice of helicopter performance
    in vertical flight (1978), as in Johnson, NASA TP-2005-213477. Gone where the wake is left behind.
    """
    plane, _, _ = _flow(m)
    vh = m.airframe.hover_inflow_m_s * np.maximum(m.speeds, 1.0) / m.airframe.hover_rad_s
    rate = np.minimum(m.hub_airspeed[:, 2] / vh, 0.0)
    young = np.where(rate > -1.5, 1.0 - rate, 7.0 + 3.0 * rate)
    climb_branch = -0.5 * rate + np.sqrt(0.25 * rate**2 + 1.0)
    excess = np.maximum(young - climb_branch, 0.0) * (rate > -2.0)
    fade = np.exp(-((plane / vh[:, None]) ** 2).sum(axis=1))
    # Blade elements: dT/T = −¼ slope (excess v_h / tip speed) / thrust coefficient.
    loss = 0.25 * m.blades.slope * excess * m.blades.inflow / m.blades.hover_thrust
    return m.thrusts(-share * loss * fade * m.thrust_n)


def rate_damping(m: Moment, kx: float, ky: float, kz: float) -> Wrench:
    """Moment against the rates, as of a guard that turns in the air at low Reynolds numbers: linear."""
    return _ZERO, -np.array([kx, ky, kz]) * m.rates


def gyroscopic(m: Moment, inertia: float) -> Wrench:
    """Rate of change of the rotors' angular momentum that the body turns; a clockwise rotor's points down."""
    spin = np.asarray(m.airframe.parameters["rotor_directions"])
    momentum = -inertia * float(spin @ m.speeds) * UP
    return _ZERO, -np.cross(m.rates, momentum)


def spin_up(m: Moment, inertia: float) -> Wrench:
    """Reaction to rotors that change their speed."""
    spin = np.asarray(m.airframe.parameters["rotor_directions"])
    return _ZERO, inertia * float(spin @ m.spin_ups) * UP


def rotor_tilt(m: Moment, rotor: float, heading: float, angle: float) -> Wrench:
    """One shaft leans towards a heading in the body; thrust and torque go with it."""
    which = int(rotor)
    lean = np.array([np.sin(angle) * np.cos(heading), np.sin(angle) * np.sin(heading), np.cos(angle) - 1.0])
    forces = np.zeros((4, 3))
    forces[which] = m.thrust_n[which] * lean
    force, moment = m.at_hubs(forces)
    p = m.airframe.parameters
    torque = p["rotor_directions"][which] * p["k_m"] / p["k_eta"] * m.thrust_n[which]
    return force, moment + torque * lean


def weak_rotor(m: Moment, rotor: float, loss: float, torque_loss: float) -> Wrench:
    """One rotor that lost part of its thrust and another part of its torque."""
    which, p = int(rotor), m.airframe.parameters
    gained = np.zeros(4)
    gained[which] = -loss * m.thrust_n[which]
    force, moment = m.thrusts(gained)
    torque = p["rotor_directions"][which] * p["k_m"] / p["k_eta"] * m.thrust_n[which]
    return force, moment - torque_loss * torque * UP


def force_bias(m: Moment, x: float, y: float, z: float) -> Wrench:  # noqa: ARG001
    """A constant force in body axes."""
    return np.array([x, y, z]), _ZERO


def moment_bias(m: Moment, x: float, y: float, z: float) -> Wrench:  # noqa: ARG001
    """A constant moment in body axes."""
    return _ZERO, np.array([x, y, z])


def tether(m: Moment, stiffness: float, length: float, damping: float) -> Wrench:
    """An elastic line from the ground below the start to the belly, with material damping; it only pulls."""
    line = m.position
    distance = float(np.linalg.norm(line))
    if distance <= length:
        return _ZERO, _ZERO
    away = line / distance
    pull = max(stiffness * (distance - length) + damping * float(m.velocity @ away), 0.0)
    return m.in_body(-pull * away), _ZERO


# Of no library.


def wall(m: Moment, share: float, at: float, reach: float) -> Wrench:
    """A wall ahead: air that it turns back pushes the vehicle away and its nose up, over some arms' length.

    Shape of the force after Carter et al., Influence of near-wall flight on multirotors (2021).
    """
    near = share * m.airframe.weight_n * np.exp(-max(at - m.position[0], 0.0) / reach)
    force = m.in_body(np.array([-near, 0.0, 0.25 * near]))
    return force, 0.4 * m.airframe.arm_m * np.cross(UP, force)


def thermal(m: Moment, share: float, east: float, width: float) -> Wrench:
    """Air that rises over a radiator: a lift over one strip of the hall."""
    lift = share * m.airframe.weight_n * np.exp(-0.5 * ((m.position[1] - east) / width) ** 2)
    return m.in_body(np.array([0.0, 0.0, lift])), _ZERO


def gimbal_scan(m: Moment, nm: float, frequency_hz: float) -> Wrench:
    """A camera that a gimbal swings to and fro: reaction in roll and yaw, at an instant of its own."""
    phase = 2.0 * np.pi * frequency_hz * m.time_s + m.memory.get("phase", 0.0)
    return _ZERO, nm * np.array([np.sin(phase), 0.0, 0.6 * np.sin(phase + 0.7)])


def dragged_cable(m: Moment, share: float) -> Wrench:
    """A supply cable on the ground: its weight below the vehicle, and Coulomb friction of the rest."""
    height = max(float(m.position[2]), 0.0)
    speed = float(np.hypot(*m.velocity[:2]))
    friction = -share * m.airframe.weight_n * m.velocity[:2] / (speed + 0.05)
    hanging = -0.3 * share * m.airframe.weight_n * height
    return m.in_body(np.array([*friction, hanging])), _ZERO


def blade_stall(m: Moment, share: float) -> Wrench:
    """Blades that stall beyond the thrust of hover, front ones first: with the square of the excess."""
    hover = 0.25 * m.airframe.weight_n
    excess = np.maximum(m.thrust_n / hover - 1.0, 0.0)
    onset = np.where(m.rotors[:, 0] > 0.0, 1.0, 0.4)
    return m.thrusts(-share * onset * hover * excess**2)


LAWS: dict[str, Callable[..., Wrench]] = {
    law.__name__: law
    for law in (
        *(rotor_drag, blade_flapping, body_drag, translational_lift, inflow_damping, ground_effect),
        *(rotor_interaction, vortex_ring, rate_damping, gyroscopic, spin_up, rotor_tilt, weak_rotor),
        *(force_bias, moment_bias, tether, wall, thermal, gimbal_scan, dragged_cable, blade_stall),
    )
}
