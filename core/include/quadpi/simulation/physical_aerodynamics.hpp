// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Aerodynamics by the terms of the physical model, in a simulated flight.
#pragma once

#include "quadpi/models/physical_regressors.hpp"
#include "quadpi/simulation/state.hpp"

namespace quadpi {

// Of the terms of a rotor, those along its axis come first, then its torque, then those in its plane.
constexpr std::size_t TORQUE_TERM = offsetof(Regressors, torque) / sizeof(Wrench);
constexpr std::size_t IN_PLANE_TERM = offsetof(Regressors, rotor_drag) / sizeof(Wrench);

// What the terms give: the wrench of all, and that of each rotor by itself, which effects scale.
struct PhysicalWrench {
    PerRotor thrusts;  // N, along -z
    PerRotor torques;  // Nm on the body about z
    Wrench wrench;     // N and Nm, body axes
};

// The wrench of a motion, for a parameter of each term.
inline PhysicalWrench physical_wrench(
    const MotionSample& motion, const PhysicalVehicle& vehicle, const TermValues& values
) {
    Regressors row{};
    const Wrench* const terms = terms_of(row);
    PhysicalWrench found{};
    const double share = 1.0 / static_cast<double>(vehicle.rotors);
    double lift = 0.0, torque = 0.0, mean_induced = 0.0;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        mean_induced += share * fill_rotor(rotor, motion, vehicle, row);
        double lift_so_far = 0.0, torque_so_far = 0.0;
        for (std::size_t term = 0; term < TORQUE_TERM; ++term) {
            lift_so_far -= values[term] * terms[term][2];
        }
        for (std::size_t term = TORQUE_TERM; term < IN_PLANE_TERM; ++term) {
            torque_so_far += values[term] * terms[term][5];
        }
        found.thrusts[rotor] = lift_so_far - lift;
        found.torques[rotor] = torque_so_far - torque;
        lift = lift_so_far, torque = torque_so_far;
    }
    fill_body(mean_induced, motion, vehicle, row);
    found.wrench = wrench_of(row, values);
    return found;
}

// Fill hub velocities, thrusts, torques and wrench of a state from the rest of it.
//
// The reference thrust of a rotor [N s²] is that of the induced velocity.
inline void physical_aerodynamics(
    State& state, const VehicleNumbers& vehicle, const TermValues& values, double reference_thrust
) {
    const MotionSample motion{
        state.velocity_air, state.rates, {}, state.rotor_speeds, state.rotor_accelerations
    };
    const PhysicalVehicle body{
        vehicle.mass,
        reference_thrust,
        2.0 * vehicle.air_density * PI * (vehicle.rotor_radius * vehicle.rotor_radius),
        vehicle.rotors,
        vehicle.rotor_positions,
        vehicle.rotor_spins,
    };
    const PhysicalWrench found = physical_wrench(motion, body, values);
    fill_hub_velocities(state, vehicle);
    state.thrusts = found.thrusts;
    state.torques = found.torques;
    state.wrench = found.wrench;
}

}  // namespace quadpi
