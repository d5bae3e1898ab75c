// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Effects on the body as a whole, of surfaces near the rotors, and of a load on a cable; parameters, sources
// and sizes are in effects/airframe.py and effects/slung_load.py.
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
