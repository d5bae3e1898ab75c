// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Aerodynamic effects of the rotors; parameters, sources and sizes are in effects/rotors.py.
#pragma once

#include "quadpi/simulation/effects/parts.hpp"
#include "quadpi/simulation/rotor_local.hpp"

namespace quadpi::effects {

// Share of a rotor of coefficients that belong to all together at hover speed.
inline double share_of(const State& state, const VehicleNumbers& vehicle, int rotor) {
    return state.rotor_speeds[rotor] / (static_cast<double>(vehicle.rotors) * vehicle.hover_rotor_speed);
}

inline Wrench rotor_drag(State& state, const VehicleNumbers& vehicle, const double* p) {
    Wrench wrench = NO_WRENCH;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double k = -p[0] * share_of(state, vehicle, rotor);
        const double u = state.hub_velocity[rotor][0], v = state.hub_velocity[rotor][1];
        wrench = with_hub_force(wrench, vehicle, rotor, k * u, k * v, 0.0);
    }
    return wrench;
}

inline Wrench cross_flow(State& state, const VehicleNumbers& vehicle, const double* p) {
    Wrench wrench = NO_WRENCH;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double k = p[0] * vehicle.rotor_spins[rotor] * share_of(state, vehicle, rotor);
        const double u = state.hub_velocity[rotor][0], v = state.hub_velocity[rotor][1];
        wrench = with_hub_force(wrench, vehicle, rotor, k * v, -k * u, 0.0);
    }
    return wrench;
}

inline Wrench blade_flapping(State& state, const VehicleNumbers& vehicle, const double* p) {
    double mx = 0.0, my = 0.0;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double k = p[0] * share_of(state, vehicle, rotor);
        mx -= k * state.hub_velocity[rotor][1];
        my += k * state.hub_velocity[rotor][0];
    }
    return {0.0, 0.0, 0.0, mx, my, 0.0};
}

inline Wrench translational_lift(State& state, const VehicleNumbers& vehicle, const double* p) {
    const double share = p[0] / static_cast<double>(vehicle.rotors);
    Wrench wrench = NO_WRENCH;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double fastest = ADVANCE_RATIO_MAX * vehicle.rotor_radius * state.rotor_speeds[rotor];
        const double speed = std::min(in_plane_speed(state, rotor), fastest);
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, -share * speed * speed);
    }
    return wrench;
}

inline Wrench inflow_damping(State& state, const VehicleNumbers& vehicle, const double* p) {
    Wrench wrench = NO_WRENCH;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double k = -p[0] * share_of(state, vehicle, rotor);
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, k * state.hub_velocity[rotor][2]);
    }
    return wrench;
}

inline Wrench rotor_dissymmetry(State& state, const VehicleNumbers& vehicle, const double* p) {
    const double square = square_of(state.velocity_air);
    Wrench wrench = NO_WRENCH;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double more = square_of(state.hub_velocity[rotor]) - square;
        const double thrust = p[0] * share_of(state, vehicle, rotor) * more;
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, -thrust);
    }
    return {0.0, 0.0, 0.0, wrench[3], wrench[4], 0.0};
}

inline Wrench vortex_ring(State& state, const VehicleNumbers& vehicle, const double* p) {
    Wrench wrench = NO_WRENCH;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double x = std::max(state.hub_velocity[rotor][2], 0.0) / vehicle.hover_induced_velocity;
        const double across = in_plane_speed(state, rotor) / vehicle.hover_induced_velocity;
        const double fourth = (x * x) * (x * x);
        const double loss =
            p[0] * state.thrusts[rotor] * x * exponential(0.25 * (1.0 - fourth) - across * across);
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, loss);
    }
    return wrench;
}

inline Wrench rotor_interaction(State& state, const VehicleNumbers& vehicle, const double* p) {
    const double u = state.velocity_air[0], v = state.velocity_air[1];
    const double speed = std::sqrt(u * u + v * v);
    if (speed == 0.0) {
        return NO_WRENCH;
    }
    const double strength = p[0] * hyperbolic_tangent(speed / vehicle.hover_induced_velocity);
    Wrench wrench = NO_WRENCH;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double x = vehicle.rotor_positions[rotor][0], y = vehicle.rotor_positions[rotor][1];
        const double behind = std::max(0.0, -(x * u + y * v) / (speed * std::sqrt(x * x + y * y)));
        const double loss = strength * behind * state.thrusts[rotor];
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, loss);
    }
    return wrench;
}

}  // namespace quadpi::effects
