// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Aerodynamics of a flight by the terms of the physical model; see simulation/simulated_aerodynamics.py.
#pragma once

#include "quadpi/simulation/physical_wrench.hpp"
#include "quadpi/simulation/state.hpp"

namespace quadpi {

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
