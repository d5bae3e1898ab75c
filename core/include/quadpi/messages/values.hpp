// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Conversion between the numbers of a message (its order, FLU, ENU) and those of the core (FRD, NED).
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

#include "quadpi/estimator/output.hpp"
#include "quadpi/rotations.hpp"

namespace quadpi {

// Of an attitude in a log or message, which stores it rounded, perhaps in single precision or as integers.
constexpr double NORM_TOLERANCE = 0.05;
// √½ as the nearest double.
constexpr double SQRT_HALF = 0.7071067811865476;

// The float64 fields that end messages: of sensor_msgs/Imu, of a pose or transform, of nav_msgs/Odometry and
// of quadpi/WrenchPrediction; three of a vector, six of a twist.
using ImuNumbers = std::array<double, 37>;
using PoseNumbers = std::array<double, 7>;
using OdometryNumbers = std::array<double, 85>;
using PredictionNumbers = std::array<double, 30>;
using TwistNumbers = std::array<double, 6>;

// A quaternion (x, y, z, w), FLU to ENU, as (w, x, y, z), FRD to NED; false if it is no rotation.
//
// It is of unit length where it is a rotation, else as it comes, or not finite.
inline bool attitude_of(const double* orientation_xyzw, Quaternion& attitude) {
    const double x = orientation_xyzw[0], y = orientation_xyzw[1], z = orientation_xyzw[2],
                 w = orientation_xyzw[3];
    double norm = std::sqrt(x * x + y * y + z * z + w * w);
    const bool off = std::abs(norm - 1.0) > NORM_TOLERANCE;
    if (off) {
        norm = 1.0;
    }
    const double scale = SQRT_HALF / norm;
    attitude = {scale * (w + z), scale * (x + y), scale * (x - y), scale * (w - z)};
    return !off;
}

// A vector in body axes, FLU to FRD.
inline Vector3 body_of(const double* flu) { return {flu[0], -1.0 * flu[1], -1.0 * flu[2]}; }

// A vector in the world, ENU to NED.
inline Vector3 world_of(const double* enu) { return {enu[1], enu[0], -1.0 * enu[2]}; }

// What sensor_msgs/Imu says: orientation and covariances are not used.
inline void read_imu(const ImuNumbers& numbers, Vector3& rates, Vector3& force) {
    rates = body_of(&numbers[13]);
    force = body_of(&numbers[25]);
}

// What a pose says; false if its attitude is no rotation.
inline bool read_pose(const double* numbers, Vector3& position, Quaternion& attitude) {
    position = world_of(numbers);
    return attitude_of(numbers + 3, attitude);
}

// Variance of a part from which on a message says that it does not know it.
constexpr double UNKNOWN_VARIANCE = 1e4;

// Root mean square of three standard deviations on the diagonal of a covariance (6, 6) of a message.
//
// 0 where the message says nothing, which zeros, what is below and what is no number are; -1 for a variance
// so large that it stands for "not measured".
inline double deviation_of(const double* covariance, std::size_t first) {
    double total = 0.0;
    for (std::size_t axis = first; axis < first + 3; ++axis) {
        total += covariance[7 * axis];
    }
    const double mean = total / 3.0;
    return mean >= UNKNOWN_VARIANCE ? -1.0 : mean > 0.0 ? std::sqrt(mean) : 0.0;
}

// What an odometry says, with deviations of position, attitude and velocity; false if its attitude is no
// rotation.
inline bool read_odometry(
    const OdometryNumbers& numbers,
    Vector3& position,
    Quaternion& attitude,
    Vector3& velocity,
    Vector3& rates,
    Vector3& deviation
) {
    velocity = body_of(&numbers[43]);
    rates = body_of(&numbers[46]);
    deviation = {deviation_of(&numbers[7], 0), deviation_of(&numbers[7], 3), deviation_of(&numbers[49], 0)};
    return read_pose(numbers.data(), position, attitude);
}

// The numbers of an odometry: position, orientation, covariance, linear, angular, covariance.
inline void write_odometry(const FusedSample& sample, OdometryNumbers& numbers) {
    const Vector3& position = sample.position;
    const auto [w, x, y, z] = sample.motion.attitude;
    numbers[0] = position[1], numbers[1] = position[0], numbers[2] = -position[2];
    numbers[3] = SQRT_HALF * (x + y), numbers[4] = SQRT_HALF * (x - y);
    numbers[5] = SQRT_HALF * (w - z), numbers[6] = SQRT_HALF * (w + z);
    for (std::size_t i = 0; i < 2; ++i) {
        const Vector3& vector = i == 0 ? sample.motion.velocity : sample.motion.rates;
        numbers[43 + 3 * i] = vector[0];
        numbers[44 + 3 * i] = -vector[1], numbers[45 + 3 * i] = -vector[2];
    }
    // NED to ENU swaps the first two of each three axes and turns the third; FRD to FLU turns two.
    constexpr std::array<std::size_t, 6> from = {1, 0, 2, 4, 3, 5};
    for (std::size_t i = 0; i < 6; ++i) {
        for (std::size_t j = 0; j < 6; ++j) {
            // Adding zero makes an unknown covariance 0.0 on every axis, not -0.0.
            double sign = (i % 3 == 2) == (j % 3 == 2) ? 1.0 : -1.0;
            numbers[7 + 6 * i + j] = sign * sample.pose_covariance[from[i]][from[j]] + 0.0;
            sign = (i % 3 == 0) == (j % 3 == 0) ? 1.0 : -1.0;
            numbers[49 + 6 * i + j] = sign * sample.twist_covariance[i][j] + 0.0;
        }
    }
}

// Wrenches of one prediction in body axes, FRD, in the order of the message: forces [N], then moments [N m].
using Wrench = std::array<double, 6>;
struct PredictedWrench {
    Wrench predicted, lower, upper, measured, relative_width;
};

// The numbers of a prediction; bounds swap on the axes that change sign.
inline void write_prediction(const PredictedWrench& of, PredictionNumbers& numbers) {
    for (std::size_t axis = 0; axis < 6; ++axis) {
        const bool turned = axis % 3 != 0;
        const double sign = turned ? -1.0 : 1.0;
        numbers[axis] = sign * of.predicted[axis] + 0.0;
        numbers[6 + axis] = sign * (turned ? of.upper : of.lower)[axis] + 0.0;
        numbers[12 + axis] = sign * (turned ? of.lower : of.upper)[axis] + 0.0;
        numbers[18 + axis] = sign * of.measured[axis] + 0.0;
        numbers[24 + axis] = of.relative_width[axis];
    }
}

}  // namespace quadpi
