// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Effects of surfaces near the rotors; parameters, sources and sizes are in effects/airframe.py.
#pragma once

#include "quadpi/simulation/effects/parts.hpp"

namespace quadpi::effects {

// Nearest surface [rotor radii]: nearer the formulas are not valid, and the effect grows no more (Cheeseman
// and Bennett, ARC R&M 3021, 1955).
constexpr double NEAREST_SURFACE = 0.5;

inline Wrench ground_effect(State& state, const VehicleNumbers& vehicle, const double* p) {
    Wrench wrench = NO_WRENCH;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double height =
            std::max(hub_height(state, vehicle, rotor), NEAREST_SURFACE * vehicle.rotor_radius);
        const double ratio = vehicle.rotor_radius / (4.0 * height);
        const double across = in_plane_speed(state, rotor) / vehicle.hover_induced_velocity;
        const double gain = 1.0 / (1.0 - ratio * ratio / (1.0 + across * across)) - 1.0;
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, -p[0] * gain * state.thrusts[rotor]);
    }
    return wrench;
}

inline Wrench ceiling_effect(State& state, const VehicleNumbers& vehicle, const double* p) {
    Wrench wrench = NO_WRENCH;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double distance =
            std::max(p[1] - hub_height(state, vehicle, rotor), NEAREST_SURFACE * vehicle.rotor_radius);
        const double ratio = vehicle.rotor_radius / distance;
        const double gain = p[0] * ratio * ratio;
        wrench = with_hub_force(wrench, vehicle, rotor, 0.0, 0.0, -gain * state.thrusts[rotor]);
    }
    return wrench;
}

}  // namespace quadpi::effects
