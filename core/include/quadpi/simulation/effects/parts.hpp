// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What several effects on the wrench use, and the shape that flights may give a law; see
// effect_definition.py.
#pragma once

#include <algorithm>

#include "quadpi/simulation/state.hpp"

namespace quadpi {

// A law that flights shape is multiplied by one plus a share for the axis plus slopes times modulators.
constexpr int MODULATORS = 8;
using Shape = std::array<double, AXES + MODULATORS>;
// Largest factor on a law, the smallest being 0: beyond what was flown it neither changes sign nor grows
// without bound.
constexpr double SHAPE_MAX = 3.0;

constexpr Wrench NO_WRENCH{};

// The wrench with a force at the hub of a rotor added, and its moment r × F.
inline Wrench with_hub_force(
    const Wrench& wrench, const VehicleNumbers& vehicle, int rotor, double fx, double fy, double fz
) {
    const auto [x, y, z] = vehicle.rotor_positions[rotor];
    return {
        wrench[0] + fx,
        wrench[1] + fy,
        wrench[2] + fz,
        wrench[3] + (y * fz - z * fy),
        wrench[4] + (z * fx - x * fz),
        wrench[5] + (x * fy - y * fx),
    };
}

// Airspeed [m/s] of a hub within the plane of its disc.
inline double in_plane_speed(const State& state, int rotor) {
    const double u = state.hub_velocity[rotor][0], v = state.hub_velocity[rotor][1];
    return std::sqrt(u * u + v * v);
}

// A vector of the world in body axes.
inline Vector3 world_to_body(const Quaternion& attitude, const Vector3& world) {
    const Quaternion vector{0.0, world[0], world[1], world[2]};
    const Quaternion turned = product(inverse(attitude), product(vector, attitude));
    return {turned[1], turned[2], turned[3]};
}

// A vector of body axes in the world.
inline Vector3 body_to_world(const Quaternion& attitude, const Vector3& body) {
    const Quaternion vector{0.0, body[0], body[1], body[2]};
    const Quaternion turned = product(product(attitude, vector), inverse(attitude));
    return {turned[1], turned[2], turned[3]};
}

// Height [m] of a hub above the ground, negative below it.
inline double hub_height(const State& state, const VehicleNumbers& vehicle, int rotor) {
    const auto [x, y, z] = world_to_body(state.attitude, {0.0, 0.0, 1.0});
    const Vector3& hub = vehicle.rotor_positions[rotor];
    const double below_centre = x * hub[0] + y * hub[1] + z * hub[2];
    return -(state.position[2] + below_centre);
}

// What a shaped law may depend on beyond its formula, in the order of `effect_definition.SHAPE`.
inline std::array<double, MODULATORS> modulators(const State& state, const VehicleNumbers& vehicle) {
    const double induced = vehicle.hover_induced_velocity, radius = vehicle.rotor_radius;
    const double u = state.velocity_air[0] / induced, v = state.velocity_air[1] / induced;
    const double w = state.velocity_air[2] / induced;
    const double of_one = 1.0 / static_cast<double>(vehicle.rotors);
    double load = 0.0;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        const double share = state.rotor_speeds[rotor] / vehicle.hover_rotor_speed;
        load += of_one * (share * share);
    }
    const double speed = std::sqrt(u * u + v * v + w * w);
    const double turning = radius * length_of(state.rates);
    const double ground = radius / std::max(-state.position[2], radius);
    return {speed, u, v, w, load, turning / induced, ground, w * w};
}

// The wrench of a law as shaped.
inline Wrench shaped(
    const Wrench& wrench, const State& state, const VehicleNumbers& vehicle, const Shape& shape
) {
    if (std::all_of(shape.begin(), shape.end(), [](double value) { return value == 0.0; })) {
        return wrench;
    }
    double more = 1.0;
    const auto of = modulators(state, vehicle);
    for (int index = 0; index < MODULATORS; ++index) {
        more += shape[AXES + index] * of[index];
    }
    Wrench result;
    for (int axis = 0; axis < AXES; ++axis) {
        result[axis] = wrench[axis] * std::min(std::max(more + shape[axis], 0.0), SHAPE_MAX);
    }
    return result;
}

}  // namespace quadpi
