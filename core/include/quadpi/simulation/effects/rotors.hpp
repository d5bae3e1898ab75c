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

// Rotor that a parameter names, from 1 on.
inline int rotor_of(double number, const VehicleNumbers& vehicle) {
    return std::clamp(static_cast<int>(number) - 1, 0, static_cast<int>(vehicle.rotors) - 1);
}

inline Wrench gyroscopic(State& state, const VehicleNumbers& vehicle, const double* p) {
    double momentum = 0.0;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        momentum += p[0] * vehicle.rotor_spins[rotor] * state.rotor_speeds[rotor];
    }
    return {0.0, 0.0, 0.0, -state.rates[1] * momentum, state.rates[0] * momentum, 0.0};
}

inline Wrench spin_up(State& state, const VehicleNumbers& vehicle, const double* p) {
    double torque = 0.0;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        torque -= p[0] * vehicle.rotor_spins[rotor] * state.rotor_accelerations[rotor];
    }
    return {0.0, 0.0, 0.0, 0.0, 0.0, torque};
}

inline Wrench thrust_coefficient(State& state, const VehicleNumbers&, const double* p) {
    Wrench wrench;
    for (int axis = 0; axis < AXES; ++axis) {
        wrench[axis] = p[0] * state.aerodynamics[axis];
    }
    return wrench;
}

// The wrench with a share of a rotor's thrust and one of its torque added.
inline Wrench with_shares(
    const Wrench& wrench,
    const State& state,
    const VehicleNumbers& vehicle,
    int rotor,
    double of_thrust,
    double of_torque
) {
    const double more = -of_thrust * state.thrusts[rotor];
    Wrench result = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, more);
    result[5] += of_torque * state.torques[rotor];
    return result;
}

inline Wrench rotor_thrusts(State& state, const VehicleNumbers& vehicle, const double* p) {
    Wrench wrench = NO_WRENCH;
    // There are parameters for four rotors.
    for (int rotor = 0; rotor < std::min<std::int64_t>(vehicle.rotors, 4); ++rotor) {
        wrench = with_shares(wrench, state, vehicle, rotor, p[rotor], p[rotor]);
    }
    return wrench;
}

inline Wrench weak_rotor(State& state, const VehicleNumbers& vehicle, const double* p) {
    const int rotor = rotor_of(p[0], vehicle);
    const auto [fx, fy, fz, mx, my, mz] = with_shares(NO_WRENCH, state, vehicle, rotor, -p[1], p[2]);
    const double u = state.hub_velocity[rotor][0], v = state.hub_velocity[rotor][1];
    const double x = vehicle.rotor_positions[rotor][0], y = vehicle.rotor_positions[rotor][1];
    const double drag = p[2] * vehicle.rotor_force_along * state.rotor_speeds[rotor];
    return {fx + drag * u, fy + drag * v, fz, mx, my, mz + drag * (x * v - y * u)};
}

inline Wrench rotor_tilt(State& state, const VehicleNumbers& vehicle, const double* p) {
    const int rotor = rotor_of(p[0], vehicle);
    const double thrust = state.thrusts[rotor], torque = state.torques[rotor];
    const double x = sine(p[1] * (PI / 180.0)), y = sine(p[2] * (PI / 180.0));
    const double z = 1.0 - std::sqrt(1.0 - x * x - y * y);
    Wrench wrench = with_hub_force(NO_WRENCH, vehicle, rotor, thrust * x, thrust * y, thrust * z);
    wrench[3] -= torque * x;
    wrench[4] -= torque * y;
    wrench[5] -= torque * z;
    return wrench;
}

}  // namespace quadpi::effects
