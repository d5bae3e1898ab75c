// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// The output of the filter after an IMU sample: odometry with covariances, and the corrected IMU.
#pragma once

#include "quadpi/estimator/filter_state.hpp"

namespace quadpi {

using Matrix6 = std::array<std::array<double, 6>, 6>;

// What the monitor needs of an estimate; velocity over ground, rates and specific force in body axes.
struct Motion {
    Quaternion attitude;
    Vector3 velocity;
    Vector3 rates;
    Vector3 specific_force;
};

// One estimate: odometry, and the IMU sample less its biases.
struct FusedSample {
    std::int64_t time_ns;
    Vector3 position;
    Motion motion;
    Matrix6 pose_covariance;
    Matrix6 twist_covariance;
};

// Columns of the error state that odometry follows from: position, velocity, attitude and gyro bias.
constexpr int ODOMETRY_STATES = 12;
using OdometryJacobian = std::array<std::array<double, ODOMETRY_STATES>, 6>;

// J P Jᵀ of the first columns of P; most of J is zero.
inline Matrix6 sandwich(const OdometryJacobian& by, const ErrorMatrix& covariance) {
    OdometryJacobian projected{};
    for (int row = 0; row < 6; ++row) {
        for (int inner = 0; inner < ODOMETRY_STATES; ++inner) {
            const double factor = by[row][inner];
            if (factor != 0.0) {
                for (int column = 0; column < ODOMETRY_STATES; ++column) {
                    projected[row][column] += factor * covariance[inner][column];
                }
            }
        }
    }
    Matrix6 out{};
    for (int other = 0; other < 6; ++other) {
        for (int column = 0; column < ODOMETRY_STATES; ++column) {
            const double factor = by[other][column];
            if (factor != 0.0) {
                for (int row = other; row < 6; ++row) {
                    out[row][other] += projected[row][column] * factor;
                }
            }
        }
        for (int row = other + 1; row < 6; ++row) {
            out[other][row] = out[row][other];
        }
    }
    return out;
}

// Fill state and covariances: first-order propagation of the error state into pose and twist.
//
// With attitude error δθ in body axes, rotations about the world's axes are R δθ, and the velocity in body
// axes errs by Rᵀ δv + v × δθ. The rates err by the gyro's bias and by its noise, of that variance.
inline void fill_fused(const Estimate& estimate, double gyro_variance, FusedSample& out) {
    const Matrix3 to_world = rotation_matrix(estimate.attitude);
    Motion& motion = out.motion;
    out.time_ns = estimate.time_ns;
    out.position = estimate.position;
    motion.attitude = estimate.attitude;
    for (int axis = 0; axis < 3; ++axis) {
        double in_body = 0.0;
        for (int other = 0; other < 3; ++other) {
            in_body += to_world[other][axis] * estimate.velocity[other];
        }
        motion.velocity[axis] = in_body;
    }
    motion.rates = minus(estimate.rates, estimate.gyro_bias);
    motion.specific_force = minus(estimate.specific_force, estimate.accelerometer_bias);
    const auto [u, v, w] = motion.velocity;

    OdometryJacobian pose{}, twist{};
    for (int axis = 0; axis < 3; ++axis) {
        pose[axis][axis] = 1.0;
        twist[3 + axis][GYRO_BIAS + axis] = -1.0;
        for (int other = 0; other < 3; ++other) {
            pose[3 + axis][ATTITUDE + other] = to_world[axis][other];
            twist[axis][VELOCITY + other] = to_world[other][axis];
        }
    }
    twist[0][ATTITUDE + 1] = -w, twist[0][ATTITUDE + 2] = v;
    twist[1][ATTITUDE] = w, twist[1][ATTITUDE + 2] = -u;
    twist[2][ATTITUDE] = -v, twist[2][ATTITUDE + 1] = u;
    out.pose_covariance = sandwich(pose, estimate.covariance);
    out.twist_covariance = sandwich(twist, estimate.covariance);
    for (int axis = 3; axis < 6; ++axis) {
        out.twist_covariance[axis][axis] += gyro_variance;
    }
}

}  // namespace quadpi
