// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Effects on the body as a whole; parameters, sources and sizes are in effects/airframe.py.
#pragma once

#include "quadpi/simulation/effects/parts.hpp"

namespace quadpi::effects {

inline Wrench body_drag(State& state, const VehicleNumbers&, const double* p) {
    const auto [u, v, w] = state.velocity_air;
    const double airspeed = std::sqrt(u * u + v * v + w * w);
    return {-p[0] * airspeed * u, -p[1] * airspeed * v, -p[2] * airspeed * w, 0.0, 0.0, 0.0};
}

inline Wrench cubic_drag(State& state, const VehicleNumbers&, const double* p) {
    const auto [u, v, w] = state.velocity_air;
    const double factor = -p[0] * (u * u + v * v + w * w);
    return {factor * u, factor * v, 0.0, 0.0, 0.0, 0.0};
}

inline Wrench rate_damping(State& state, const VehicleNumbers&, const double* p) {
    const Vector3& rates = state.rates;
    return {0.0, 0.0, 0.0, -p[0] * rates[0], -p[1] * rates[1], -p[2] * rates[2]};
}

inline Wrench tether(State& state, const VehicleNumbers&, const double* p) {
    const double north = state.position[0] - p[2], east = state.position[1] - p[3];
    const double down = state.position[2] + p[4];
    const double distance = std::sqrt(north * north + east * east + down * down);
    if (distance <= p[1]) {
        return NO_WRENCH;
    }
    const double pull = -p[0] * (distance - p[1]) / distance;
    const auto [fx, fy, fz] = world_to_body(state.attitude, {pull * north, pull * east, pull * down});
    return {fx, fy, fz, -p[5] * fy, p[5] * fx, 0.0};
}

inline Wrench force_bias(State&, const VehicleNumbers&, const double* p) {
    return {p[0], p[1], p[2], 0.0, 0.0, 0.0};
}

inline Wrench moment_bias(State&, const VehicleNumbers&, const double* p) {
    return {0.0, 0.0, 0.0, p[0], p[1], p[2]};
}

inline Wrench cg_offset(State& state, const VehicleNumbers&, const double* p) {
    const double fx = state.wrench[0], fy = state.wrench[1], fz = state.wrench[2];
    return {0.0, 0.0, 0.0, p[2] * fy - p[1] * fz, p[0] * fz - p[2] * fx, p[1] * fx - p[0] * fy};
}

}  // namespace quadpi::effects
