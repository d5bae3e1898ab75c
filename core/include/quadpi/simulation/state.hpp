// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What the physics of a flight works on: the state at an instant, and the vehicle; see state_records.py.
//
// Body axes forward-right-down, world north-east-down with the ground at height 0, SI units. Rotors in the
// order of the vehicle file.
#pragma once

#include "quadpi/signals/chain.hpp"
#include "quadpi/signals/wrench.hpp"

namespace quadpi {

// Numbers that an effect may keep as a state of its own.
constexpr int MEMORY = 6;
using OwnState = std::array<double, MEMORY>;

// State at an instant, with what the aerodynamics and the effects add to it.
struct State {
    Vector3 position;
    Quaternion attitude;   // body to world
    Vector3 velocity_air;  // relative to the air, body axes
    Vector3 rates;
    PerRotor rotor_speeds;
    PerRotor rotor_accelerations;
    std::array<Vector3, ROTORS_MAX> hub_velocity;  // of each rotor's hub relative to the air, body axes
    PerRotor thrusts;                              // along -z, of the aerodynamics alone
    PerRotor torques;                              // on the body about z, of the aerodynamics alone
    Wrench aerodynamics;                           // alone
    Wrench wrench;                                 // with the effects applied so far
    double force_is_measured;  // 1 where every effect is already part of the force of `wrench`, else 0
    OwnState memory;           // of an effect that has a state of its own
    OwnState memory_slope;     // its derivative in time, which the effect fills
};

// A vehicle and its rotor-local aerodynamics.
struct VehicleNumbers {
    double mass;
    double gravity;
    double air_density;
    Matrix3 inertia;
    Matrix3 inverse_inertia;
    std::int64_t rotors;
    std::array<Vector3, ROTORS_MAX> rotor_positions;
    PerRotor rotor_spins;  // +1 where the rotor turns clockwise seen from above
    double rotor_radius;
    double hover_induced_velocity;  // of the vehicle as in its file, like the next
    double hover_rotor_speed;
    double motor_time_constant;
    double rotor_speed_max;
    double rotor_inertia;  // where the torque of rotors that speed up is part of the aerodynamics, else 0
    std::array<double, 16> thrust;
    std::array<double, 16> torque;
    double rotor_force_along;
    double rotor_force_across;
    double rotor_moment_along;
    double rotor_moment_across;
    double airframe_area;
    std::array<double, 2> airframe_fx;
    std::array<double, 2> airframe_fy;
    std::array<double, 2> airframe_fz;
    std::array<double, 6> airframe_mx;
    std::array<double, 6> airframe_my;
    std::array<double, 6> airframe_mz;
};

// Fill the velocities of the hubs: that of the body and its turning.
inline void fill_hub_velocities(State& state, const VehicleNumbers& vehicle) {
    const auto [p, q, r] = state.rates;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const auto [x, y, z] = vehicle.rotor_positions[rotor];
        state.hub_velocity[rotor] = {
            state.velocity_air[0] + q * z - r * y,
            state.velocity_air[1] + r * x - p * z,
            state.velocity_air[2] + p * y - q * x,
        };
    }
}

}  // namespace quadpi
