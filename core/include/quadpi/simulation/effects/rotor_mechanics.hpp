// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Effects of the rotors as built; parameters, sources and sizes are in effects/rotors.py.
#pragma once

#include "quadpi/simulation/effects/parts.hpp"

namespace quadpi::effects {

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
