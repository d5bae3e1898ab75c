// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// A load on a cable below the vehicle, which swings; parameters and law are in effects/slung_load.py.
#pragma once

#include "quadpi/simulation/effects/parts.hpp"

namespace quadpi::effects {

// Shortest cable [m]: on a shorter one the load swings faster than flights are integrated.
constexpr double SHORTEST_CABLE_M = 0.05;

inline Wrench slung_load(State& state, const VehicleNumbers& vehicle, const double* p) {
    const double mass = p[0], length = std::max(p[1], SHORTEST_CABLE_M), damping = p[2];
    const OwnState& memory = state.memory;
    OwnState& slope = state.memory_slope;
    const double size = std::sqrt(memory[0] * memory[0] + memory[1] * memory[1] + memory[2] * memory[2]);
    const Wrench& force = state.wrench;
    auto [fx, fy, fz] = body_to_world(state.attitude, {force[0], force[1], force[2]});
    fx /= vehicle.mass, fy /= vehicle.mass, fz /= vehicle.mass;
    double nx, ny, nz;
    if (size == 0.0) {
        // Without a state of its own, as in records of single instants, the load hangs along the force.
        const double along = std::sqrt(fx * fx + fy * fy + fz * fz);
        if (along == 0.0) {
            return NO_WRENCH;
        }
        nx = -fx / along, ny = -fy / along, nz = -fz / along;
    } else {
        nx = memory[0] / size, ny = memory[1] / size, nz = memory[2] / size;
    }
    double vx = memory[3], vy = memory[4], vz = memory[5];
    const double along = nx * vx + ny * vy + nz * vz;
    vx -= along * nx, vy -= along * ny, vz -= along * nz;
    const double turning = vx * vx + vy * vy + vz * vz;
    const double pulled = nx * fx + ny * fy + nz * fz;
    double tension = mass * std::max(length * turning - pulled, 0.0);
    if (state.force_is_measured == 0.0) {
        // The force is that without the cable, which pulls the vehicle towards the load.
        tension *= vehicle.mass / (vehicle.mass + mass);
    }
    slope[0] = size * vx, slope[1] = size * vy, slope[2] = size * vz;
    slope[3] = -(fx - pulled * nx) / length - turning * nx - damping * vx;
    slope[4] = -(fy - pulled * ny) / length - turning * ny - damping * vy;
    slope[5] = -(fz - pulled * nz) / length - turning * nz - damping * vz;
    const auto [x, y, z] = world_to_body(state.attitude, {tension * nx, tension * ny, tension * nz});
    return {x, y, z, -p[3] * y, p[3] * x, 0.0};
}

}  // namespace quadpi::effects
