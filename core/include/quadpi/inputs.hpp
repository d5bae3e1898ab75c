// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// The aerodynamic input vector X (van Beers and de Visser, Eq. 4 to 10); see inputs.py.
#pragma once

#include <algorithm>

#include "quadpi/signals/chain.hpp"

namespace quadpi {

constexpr int INPUTS = 19;
using InputVector = std::array<double, INPUTS>;
// Whether an input is the cosine of an angle: near 1 it goes with its square.
constexpr bool IS_COSINE[INPUTS] = {
    false, false, false, false, false, false, false, false, false, true,
    false, true,  false, false, false, false, false, false, false,
};

// Below this mean speed the rotors stand still and an advance ratio means nothing: it is set to 0.
constexpr double ROTORS_AT_REST_RAD_S = 1.0;
constexpr int NEWTON_STEPS_MAX = 80;
constexpr double NEWTON_CONVERGED = 1e-15;

// Numbers of a vehicle that inputs and wrench follow from.
struct VehicleConstants {
    std::int64_t rotors;
    std::array<PerRotor, 3> control_signs;  // of U_p, U_q, U_r
    double rotor_radius;                    // m
    double hover_induced_velocity;          // m/s
    double air_density;                     // kg/m³
    double mass;                            // kg
    Matrix3 inertia;                        // kg m²
};

// What a model may know of the motion beside the input vector; it has passed the same low-pass.
struct Derivatives {
    Vector3 angular_acceleration;  // rad/s², measured, body axes
    PerRotor rotor_speeds;         // rad/s
    PerRotor rotor_accelerations;  // rad/s²
    PerRotor rotor_jerks;          // rad/s³
    double density_excess;         // by what share the air is denser than the vehicle file says
};

// Velocity [m/s] relative to the air, body axes: ground velocity (body) less wind (world).
inline Vector3 relative_to_air(const Vector3& velocity, const Quaternion& attitude, const Vector3& wind) {
    const auto [w, x, y, z] = attitude;
    const auto [north, east, down] = wind;
    return {
        velocity[0] -
            ((1 - 2 * (y * y + z * z)) * north + 2 * (x * y + w * z) * east + 2 * (x * z - w * y) * down),
        velocity[1] -
            (2 * (x * y - w * z) * north + (1 - 2 * (x * x + z * z)) * east + 2 * (y * z + w * x) * down),
        velocity[2] -
            (2 * (x * z + w * y) * north + 2 * (y * z - w * x) * east + (1 - 2 * (x * x + y * y)) * down),
    };
}

// Induced velocity [m/s] of momentum theory, from the velocity in the rotor plane and through it (Eq. 8).
//
// Solves v_in = v_h² / √((V cos α)² + (v_in − V sin α)²) in units of v_h. Where descent allows several roots,
// the largest is taken: it belongs to the working state of the rotor and joins hover without a jump. The
// start lies above the largest root, where the quartic rises and is convex, so Newton's method falls onto it;
// a bracket that shrinks with each sign guards the few cases with an inflection between.
inline double solve_induced_velocity(double in_plane, double through, double hover) {
    const double ratio = in_plane / hover;
    const double a = ratio * ratio, b = through / hover;
    double low = 0.0;
    double high = std::max(b, 0.0) + 1.0;
    double x = high;
    for (int step = 0; step < NEWTON_STEPS_MAX; ++step) {
        const double excess = x * x * (a + (x - b) * (x - b)) - 1.0;
        const double slope = 2.0 * x * (a + (x - b) * (2.0 * x - b));
        (excess > 0.0 ? high : low) = x;
        const double newton = slope > 0.0 ? x - excess / slope : low;
        const double previous = x;
        x = low < newton && newton <= high ? newton : 0.5 * (low + high);
        if (std::abs(x - previous) <= NEWTON_CONVERGED * x) {
            break;
        }
    }
    return x * hover;
}

// Fill the input vector of one sample.
inline void fill_inputs(
    const Vector3& velocity_air,
    const Quaternion& attitude,
    const Vector3& rates,
    const PerRotor& rotor_speeds,
    const VehicleConstants& vehicle,
    InputVector& row
) {
    const auto [u, v, w] = velocity_air;
    const auto [q0, q1, q2, q3] = attitude;
    const double v_in = solve_induced_velocity(std::sqrt(u * u + v * v), w, vehicle.hover_induced_velocity);

    double square_sum = 0.0;
    for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
        square_sum += rotor_speeds[rotor] * rotor_speeds[rotor];
    }
    const double omega_avg = std::sqrt(square_sum / static_cast<double>(vehicle.rotors));
    const double tip_speed = omega_avg * vehicle.rotor_radius;
    const double per_tip_speed = omega_avg > ROTORS_AT_REST_RAD_S ? 1.0 / tip_speed : 0.0;

    // Third row of the body-to-world matrix: −sin θ, sin φ cos θ, cos φ cos θ.
    const double sin_theta = std::min(1.0, std::max(-1.0, 2.0 * (q0 * q2 - q1 * q3)));
    const double cos_theta = std::sqrt(1.0 - sin_theta * sin_theta);
    const double across = 2.0 * (q2 * q3 + q0 * q1), along = 1.0 - 2.0 * (q1 * q1 + q2 * q2);
    const double size = std::sqrt(across * across + along * along);
    // With the nose straight up or down roll is free: it is 0.
    const double sin_phi = size == 0.0 ? 0.0 : across / size, cos_phi = size == 0.0 ? 1.0 : along / size;

    row[0] = u, row[1] = v, row[2] = w, row[3] = v_in;
    row[4] = rates[0], row[5] = rates[1], row[6] = rates[2];
    row[7] = omega_avg;
    row[8] = sin_phi, row[9] = cos_phi, row[10] = sin_theta, row[11] = cos_theta;
    for (int control = 0; control < 3; ++control) {
        double moment = 0.0;
        for (int rotor = 0; rotor < vehicle.rotors; ++rotor) {
            moment += vehicle.control_signs[control][rotor] * rotor_speeds[rotor];
        }
        row[12 + control] = moment;
    }
    row[15] = u * per_tip_speed, row[16] = v * per_tip_speed, row[17] = w * per_tip_speed;
    row[18] = v_in * per_tip_speed;
}

}  // namespace quadpi
