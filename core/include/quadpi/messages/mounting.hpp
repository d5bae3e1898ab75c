// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Conversion of the samples of a rotated or displaced IMU to the body's axes and origin.
//
// With R the rotation from the IMU's axes to the body's, r the IMU's position in the body, ω = R ω_imu and
// α = dω/dt,
//
//     f = R f_imu − α × r − ω × (ω × r).
#pragma once

#include "quadpi/limits.hpp"
#include "quadpi/records.hpp"
#include "quadpi/rotations.hpp"

namespace quadpi {

// Time constant of the low-pass that α goes through [s].
constexpr double MOUNTING_LAG_S = 0.001;

// Where an IMU is, and the last sample that could be used.
struct MountedImu {
    Matrix3 rotation;        // from the IMU's axes to the body's
    Vector3 arm;             // m, its position in the body
    std::int64_t before_ns;  // negative before the first sample
    Vector3 rates;           // rad/s
    Vector3 acceleration;    // rad/s²
};

// Change rates [rad/s] and specific force [m/s²] of one sample to those of the body.
inline void move_to_body(MountedImu& imu, std::int64_t time_ns, Vector3& rates, Vector3& force) {
    const Vector3 omega = times(imu.rotation, rates), felt = times(imu.rotation, force);
    const bool known = within(omega, RATE_MAX_RAD_S);
    Vector3 alpha = imu.acceleration;
    // Stamps of messages are bounded; of unbounded ones the difference wraps instead of being undefined.
    const auto step_ns = static_cast<std::int64_t>(
        static_cast<std::uint64_t>(time_ns) - static_cast<std::uint64_t>(imu.before_ns)
    );
    if (imu.before_ns < 0 || step_ns < 0 || step_ns > MAX_GAP_NS) {
        alpha = {};
    } else if (known) {
        const double step_s = 1e-9 * static_cast<double>(step_ns);
        for (int axis = 0; axis < 3; ++axis) {
            alpha[axis] += (omega[axis] - imu.rates[axis] - step_s * alpha[axis]) / (MOUNTING_LAG_S + step_s);
        }
    }
    const Vector3 tangential = cross(alpha, imu.arm), centripetal = cross(omega, cross(omega, imu.arm));
    rates = omega;
    for (int axis = 0; axis < 3; ++axis) {
        force[axis] = felt[axis] - tangential[axis] - centripetal[axis];
    }
    if (known) {
        imu.before_ns = time_ns;
        imu.rates = omega;
        imu.acceleration = alpha;
    }
}

}  // namespace quadpi
