# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of rotors, each (state, vehicle, b) -> wrench; b holds parameters, then memory."""

from __future__ import annotations

import math

from blind.geometry import NOTHING, force_at, induced_ratio, lift_at, plus

# Share of the lost share of thrust by which the torque of a chipped blade is less.
WEAK_TORQUE = 0.8


def rotor_drag(state, vehicle, b):
    """At the centre of gravity, with the sum of the rotor speeds (Faessler, Franchi and Scaramuzza 2018).

    b: N s/m of all rotors in hover.
    """
    total = 0.0
    for rotor in range(4):
        total += state.rotor_speeds[rotor]
    k = -b[0] * total / (4.0 * vehicle.hover_rotor_speed)
    return k * state.velocity_air[0], k * state.velocity_air[1], 0.0, 0.0, 0.0, 0.0


def blade_flapping(state, vehicle, b):
    """Discs that tilt back in proportion to the advance ratio (Hoffmann et al. 2007; Pounds et al. 2010).

    A stiff hub gives most of the moment, with the thrust; the tilted thrust, above the centre of gravity,
    adds its force and the rest. A stiff blade answers less than 90° late, hence a share across.

    b: Nm s/m of all hubs in hover, tilt [rad] per advance ratio, arm [m], share across.
    """
    weight = vehicle.mass * vehicle.gravity
    wrench = NOTHING
    for rotor in range(4):
        u, v = state.hub_velocity[rotor][0], state.hub_velocity[rotor][1]
        tip = max(state.rotor_speeds[rotor], 50.0) * vehicle.rotor_radius
        thrust, spin = state.thrusts[rotor], vehicle.rotor_spins[rotor]
        # The moment goes with thrust and advance ratio, like the tilt.
        scale = b[0] * thrust / weight * vehicle.hover_rotor_speed * vehicle.rotor_radius / tip
        hub = (0.0, 0.0, 0.0, scale * (-v + spin * b[3] * u), scale * (u + spin * b[3] * v), 0.0)
        fx, fy = -thrust * b[1] * u / tip, -thrust * b[1] * v / tip
        x, y, z = vehicle.rotor_positions[rotor]
        wrench = plus(plus(wrench, hub), force_at(x, y, z - b[2], fx, fy, 0.0))
    return wrench


def translational_lift(state, vehicle, b):
    """Blade elements and momentum: less induced velocity, more dynamic pressure (Leishman 2006).

    C_T ∝ θ/3 (1 + 3/2 μ²) − λ/2, with λ from Glauert's equation.

    b: share of that gain which the simulation lacks, θ of the blades [rad].
    """
    wrench = NOTHING
    inflow = vehicle.hover_induced_velocity
    for rotor in range(4):
        u, v = state.hub_velocity[rotor][0], state.hub_velocity[rotor][1]
        across = math.sqrt(u * u + v * v)
        tip = max(state.rotor_speeds[rotor], 100.0) * vehicle.rotor_radius
        hover = vehicle.hover_rotor_speed * vehicle.rotor_radius
        pitch, mu = b[1] / 3.0, min(across / tip, 0.5)
        rest = pitch - 0.5 * inflow / hover
        gain = 1.5 * pitch * mu * mu + 0.5 * (1.0 - induced_ratio(across / inflow)) * inflow / tip
        wrench = plus(wrench, lift_at(vehicle, rotor, b[0] * state.thrusts[rotor] * gain / rest))
    return wrench


def inflow_damping(state, vehicle, b):
    """Axial climb: blade elements in the inflow v_i + climb of momentum theory, the climb branch throughout.

    U = v_i − w with v_i (v_i − w) = v_h²: half as steep as at a fixed v_i near hover, steeper in climb.

    b: N s/m of all rotors at hover, near w = 0.
    """
    wrench = NOTHING
    hover = vehicle.hover_induced_velocity
    for rotor in range(4):
        w = state.hub_velocity[rotor][2]
        more = -0.5 * w + math.sqrt(0.25 * w * w + hover * hover) - hover
        share = 0.25 * state.rotor_speeds[rotor] / vehicle.hover_rotor_speed
        wrench = plus(wrench, lift_at(vehicle, rotor, -2.0 * b[0] * share * more))
    return wrench


def vortex_ring(state, vehicle, b):
    """Leishman's quartic through measured induced velocities of descent, beyond that of the climb branch.

    v_i/v_h = 1 − 1.125 x − 1.372 x² − 1.718 x³ − 0.655 x⁴, −2 ≤ x = climb/v_h ≤ 0. It ends as the rotor flies
    out of its wake.

    b: share of thrust lost at the worst.
    """
    wrench = NOTHING
    hover = vehicle.hover_induced_velocity
    for rotor in range(4):
        u, v, w = state.hub_velocity[rotor]
        x = min(max(-w / hover, -2.0), 0.0)
        measured = 1.0 + x * (-1.125 + x * (-1.372 + x * (-1.718 - 0.655 * x)))
        smooth = -0.5 * x + math.sqrt(0.25 * x * x + 1.0)
        washed = math.exp(-(u * u + v * v) / (hover * hover))
        # 0.2: the largest excess, at x = -1.1.
        loss = b[0] * max(measured - smooth, 0.0) / 0.2 * washed
        wrench = plus(wrench, lift_at(vehicle, rotor, -loss * state.thrusts[rotor]))
    return wrench


def rotor_interaction(state, vehicle, b):
    """Each rotor downstream of another flies in its skewed wake: by pairs, with the sine of the skew angle.

    b: share of thrust lost straight behind the nearest neighbour in fast flight.
    """
    u, v = state.velocity_air[0], state.velocity_air[1]
    speed = math.sqrt(u * u + v * v)
    if speed < 1e-9:
        return NOTHING
    hover = vehicle.hover_induced_velocity
    induced = hover * induced_ratio(speed / hover)
    skew = speed / math.sqrt(speed * speed + induced * induced)
    nearest = 2.0 * min(abs(vehicle.rotor_positions[0][0]), abs(vehicle.rotor_positions[0][1]))
    wrench = NOTHING
    for rotor in range(4):
        wakes = 0.0
        for other in range(4):
            x = vehicle.rotor_positions[rotor][0] - vehicle.rotor_positions[other][0]
            y = vehicle.rotor_positions[rotor][1] - vehicle.rotor_positions[other][1]
            distance = math.sqrt(x * x + y * y)
            if distance > 0.0:
                behind = max(-(x * u + y * v) / (distance * speed), 0.0)
                wakes += behind * behind * nearest / distance
        wrench = plus(wrench, lift_at(vehicle, rotor, -b[0] * skew * wakes * state.thrusts[rotor]))
    return wrench


def ground_effect(state, vehicle, b):
    """Four rotors over the ground, with the fountain between them (Sanchez-Cuevas, Heredia and Ollero 2017).

    b: multiple of their law.
    """
    radius, down = vehicle.rotor_radius, -state.position[2]
    along, across = 2.0 * abs(vehicle.rotor_positions[0][0]), 2.0 * abs(vehicle.rotor_positions[0][1])
    side, diagonal = 0.5 * (along + across), math.sqrt(along * along + across * across)
    # Third row of the attitude's matrix: how far below the centre of gravity a hub is.
    w, x, y, z = state.attitude
    row = (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    wrench = NOTHING
    for rotor in range(4):
        hub = vehicle.rotor_positions[rotor]
        height = max(down - row[0] * hub[0] - row[1] * hub[1] - row[2] * hub[2], 0.6 * radius)
        square = radius * radius
        lost = (
            square / (16.0 * height * height)
            + square * height / (side * side + 4.0 * (height * height)) ** 1.5
            + 0.5 * square * height / (2.0 * (side * side) + 4.0 * (height * height)) ** 1.5
            + 4.0 * square * height / (diagonal * diagonal + 4.0 * (height * height)) ** 1.5
        )
        u, v = state.hub_velocity[rotor][0], state.hub_velocity[rotor][1]
        inflow = vehicle.hover_induced_velocity
        swept = 1.0 + (u * u + v * v) / (inflow * inflow)
        gain = b[0] * (1.0 / (1.0 - min(lost, 0.6)) - 1.0) / swept
        wrench = plus(wrench, lift_at(vehicle, rotor, gain * state.thrusts[rotor]))
    return wrench


def gyroscopic(state, vehicle, b):
    """−Ω × H of the rotors, which turn with the body too.

    b: kg m² of one rotor.
    """
    momentum = 0.0
    for rotor in range(4):
        momentum += b[0] * (vehicle.rotor_spins[rotor] * state.rotor_speeds[rotor] + state.rates[2])
    return 0.0, 0.0, 0.0, -state.rates[1] * momentum, state.rates[0] * momentum, 0.0


def spin_up(state, vehicle, b):
    """The motors' reaction to what accelerates the rotors.

    b: kg m² of one rotor.
    """
    reaction = 0.0
    for rotor in range(4):
        reaction += vehicle.rotor_spins[rotor] * state.rotor_accelerations[rotor]
    return 0.0, 0.0, 0.0, 0.0, 0.0, -b[0] * reaction


def rotor_tilt(state, vehicle, b):
    """One rotor's axis is turned: thrust, torque and both their lost shares along z.

    b: rotor, direction [rad] to which it leans, lean [rad].
    """
    rotor = int(b[0])
    x, y, z = math.sin(b[2]) * math.cos(b[1]), math.sin(b[2]) * math.sin(b[1]), 1.0 - math.cos(b[2])
    thrust, torque = state.thrusts[rotor], state.torques[rotor]
    px, py, pz = vehicle.rotor_positions[rotor]
    turned = (0.0, 0.0, 0.0, -torque * x, -torque * y, -torque * z)
    return plus(force_at(px, py, pz, thrust * x, thrust * y, thrust * z), turned)


def weak_rotor(state, vehicle, b):
    """A chipped blade: the tip's thrust is lost, of the torque and the force in the plane a smaller share.

    b: rotor, share of thrust lost.
    """
    rotor = int(b[0])
    u, v = state.hub_velocity[rotor][0], state.hub_velocity[rotor][1]
    drag = 0.7 * b[1] * vehicle.rotor_force_along * state.rotor_speeds[rotor]
    x, y, z = vehicle.rotor_positions[rotor]
    lost = force_at(x, y, z, -drag * u, -drag * v, b[1] * state.thrusts[rotor])
    return plus(lost, (0.0, 0.0, 0.0, 0.0, 0.0, -WEAK_TORQUE * b[1] * state.torques[rotor]))
