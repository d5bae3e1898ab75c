// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Rotor-local aerodynamics: each rotor sees its own airspeed; sources in rotor_local.py.
#pragma once

#include "quadpi/simulation/state.hpp"

namespace quadpi {

// Largest advance ratio of the fit, airspeed of the hub over speed of the blade tip: its polynomials grow
// without bound beyond (Bebop 2 in a wind tunnel, as published in SihaoSun/INDI_Quadrotor_FTC).
constexpr double ADVANCE_RATIO_MAX = 0.6;

// C_T or C_Q of advance ratio m and disc angle a, as nested products of the 16 terms.
inline double rotor_coefficient(const std::array<double, 16>& c, double m, double a) {
    const double free = c[0] + m * (c[1] + m * (c[2] + m * (c[3] + m * (c[4] + m * c[5]))));
    const double first = m * (c[6] + m * (c[7] + m * (c[8] + m * c[9])));
    const double second = m * (c[10] + m * (c[11] + m * c[12]));
    const double third = m * (c[13] + m * c[14]);
    return free + a * (first + a * (second + a * (third + a * m * c[15])));
}

inline double airframe_force(const std::array<double, 2>& c, double x) {
    return sign_of(x) * (c[0] * std::abs(x) + c[1] * x * x);
}

inline double airframe_moment(const std::array<double, 6>& c, double x, double y) {
    return x * (c[0] + x * (c[1] + x * c[3] + y * c[5]) + y * (c[2] + y * c[4]));
}

// Add the wrench of the airframe: of air at rest, none.
inline void add_airframe(State& state, const VehicleNumbers& vehicle) {
    auto [u, v, w] = state.velocity_air;
    const double square = u * u + v * v + w * w;
    if (square == 0.0) {
        return;
    }
    const double airspeed = std::sqrt(square);
    u /= airspeed, v /= airspeed, w /= airspeed;
    const double pressure_area = 0.5 * vehicle.air_density * vehicle.airframe_area * square;
    Wrench& wrench = state.wrench;
    wrench[0] += pressure_area * airframe_force(vehicle.airframe_fx, u);
    wrench[1] += pressure_area * airframe_force(vehicle.airframe_fy, v);
    wrench[2] += pressure_area * airframe_force(vehicle.airframe_fz, w);
    wrench[3] += pressure_area * sign_of(v) * airframe_moment(vehicle.airframe_mx, std::abs(v), w);
    wrench[4] += pressure_area * sign_of(u) * airframe_moment(vehicle.airframe_my, std::abs(u), w);
    wrench[5] += pressure_area * sign_of(u) * sign_of(v) *
                 airframe_moment(vehicle.airframe_mz, std::abs(v), std::abs(u));
}

// Fill hub velocities, thrusts, torques and wrench of a state from the rest of it.
//
// A rotor at rest has the largest advance ratio of the fit; air at rest has disc angle 0.
inline void rotor_local(State& state, const VehicleNumbers& vehicle) {
    const double radius = vehicle.rotor_radius;
    const double disc = vehicle.air_density * PI * ((radius * radius) * (radius * radius));
    Wrench& wrench = state.wrench;
    wrench = {};
    fill_hub_velocities(state, vehicle);
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double x = vehicle.rotor_positions[rotor][0], y = vehicle.rotor_positions[rotor][1];
        const double spin = vehicle.rotor_spins[rotor], speed = state.rotor_speeds[rotor];
        const auto [u, v, w] = state.hub_velocity[rotor];
        const double in_plane = std::sqrt(u * u + v * v);
        const double airspeed = std::sqrt(in_plane * in_plane + w * w);
        const double tip_speed = speed * radius;
        const bool fitted = airspeed < ADVANCE_RATIO_MAX * tip_speed;
        const double advance_ratio = fitted ? airspeed / tip_speed : ADVANCE_RATIO_MAX;
        const double disc_angle = arctangent(w, in_plane);

        const double thrust =
            rotor_coefficient(vehicle.thrust, advance_ratio, disc_angle) * disc * speed * speed;
        const double torque = spin * rotor_coefficient(vehicle.torque, advance_ratio, disc_angle) * disc *
                              radius * speed * speed;
        const double force_x =
            speed * (vehicle.rotor_force_along * u + spin * vehicle.rotor_force_across * v);
        const double force_y =
            speed * (vehicle.rotor_force_along * v - spin * vehicle.rotor_force_across * u);
        const double hub_x =
            speed * (spin * vehicle.rotor_moment_across * u - vehicle.rotor_moment_along * v);
        const double hub_y =
            speed * (vehicle.rotor_moment_along * u + spin * vehicle.rotor_moment_across * v);

        state.thrusts[rotor] = thrust, state.torques[rotor] = torque;
        wrench[0] += force_x;
        wrench[1] += force_y;
        wrench[2] -= thrust;
        wrench[3] += hub_x - y * thrust;
        wrench[4] += hub_y + x * thrust;
        wrench[5] += torque - y * force_x + x * force_y;
    }
    add_airframe(state, vehicle);
}

}  // namespace quadpi
