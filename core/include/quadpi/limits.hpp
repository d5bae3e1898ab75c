// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Limits beyond which a sample comes from a broken sensor or is in a wrong unit, the same live and offline.
//
// NaN is beyond every limit.
#pragma once

#include <cmath>
#include <cstdint>

#include "quadpi/rotations.hpp"

namespace quadpi {

// Longest pause [ns] of a sensor across which samples are interpolated, integrated or filtered.
constexpr std::int64_t MAX_GAP_NS = 100'000'000;
// A stamp that steps further back [ns] is a restart (a bag played again), not a late sample.
constexpr std::int64_t MAX_JUMP_BACK_NS = 1'000'000'000;
// A recording that spans more has a damaged stamp [ns].
constexpr std::int64_t FLIGHT_MAX_NS = 2 * 86'400 * std::int64_t{1'000'000'000};
// Marks "no stamp": before every stamp, and its difference to any of them fits 64 bits.
constexpr std::int64_t NO_STAMP = -(std::int64_t{1} << 62);

// Gyros of flight controllers end at 2000 deg/s, 35 rad/s, or 4000 deg/s.
constexpr double RATE_MAX_RAD_S = 70.0;
// Accelerometers of flight controllers end at 16 g or 32 g.
constexpr double SPECIFIC_FORCE_MAX_M_S2 = 320.0;
// Of a state and of wind [m/s]; no quadrotor flies as fast.
constexpr double AIRSPEED_MAX_M_S = 100.0;
// Of a state, from 1.
constexpr double QUATERNION_NORM_TOLERANCE = 0.1;
// One g [m/s²], in which accelerometers are specified.
constexpr double STANDARD_GRAVITY = 9.80665;
// Of motion capture or satellites, which measure farther and faster than quadrotors fly.
constexpr double POSITION_MAX_M = 10'000.0;
constexpr double MEASURED_SPEED_MAX_M_S = 300.0;
// What an estimator is given may be off by any scale between these: it is normalised.
constexpr double QUATERNION_NORM_MIN = 0.5, QUATERNION_NORM_MAX = 1e6;

inline bool within(const Vector3& values, double limit) {
    return std::abs(values[0]) <= limit && std::abs(values[1]) <= limit && std::abs(values[2]) <= limit;
}

// Whether rates [rad/s] and specific force [m/s²] can be those of a flight.
inline bool usable_imu(const Vector3& rates, const Vector3& specific_force) {
    return within(rates, RATE_MAX_RAD_S) && within(specific_force, SPECIFIC_FORCE_MAX_M_S2);
}

// Whether a position [m] can be measured, and an attitude is a rotation, but for its norm.
inline bool usable_pose(const Vector3& position, const Quaternion& q) {
    const double norm2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    return within(position, POSITION_MAX_M) && QUATERNION_NORM_MIN * QUATERNION_NORM_MIN <= norm2 &&
           norm2 <= QUATERNION_NORM_MAX * QUATERNION_NORM_MAX;
}

// Whether a quaternion is near unit length.
inline bool unit_attitude(const Quaternion& q) {
    double square = 0.0;
    for (const double component : q) {
        square += component * component;
    }
    return std::abs(std::sqrt(square) - 1.0) <= QUATERNION_NORM_TOLERANCE;
}

// Whether a measured velocity [m/s] can be that of a flight.
inline bool usable_velocity(const Vector3& velocity) { return within(velocity, MEASURED_SPEED_MAX_M_S); }

}  // namespace quadpi
