// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Rotations: unit quaternions (w, x, y, z) from body to world, rotation vectors in radians, matrices.
#pragma once

#include "quadpi/elementary.hpp"

namespace quadpi {

using Vector3 = std::array<double, 3>;
using Quaternion = std::array<double, 4>;
using Matrix3 = std::array<Vector3, 3>;

// Below this angle [rad] the next term of the series, angle²/24, is under the rounding of a double.
constexpr double SMALL_ANGLE = 1e-8;

inline double sign_of(double number) { return number > 0.0 ? 1.0 : number < 0.0 ? -1.0 : 0.0; }

// The scaled difference of two vectors.
inline Vector3 minus(const Vector3& vector, const Vector3& other, double scale = 1.0) {
    return {scale * (vector[0] - other[0]), scale * (vector[1] - other[1]), scale * (vector[2] - other[2])};
}

// Vector product.
inline Vector3 cross(const Vector3& a, const Vector3& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

// Product of a matrix and a vector.
inline Vector3 times(const Matrix3& matrix, const Vector3& vector) {
    Vector3 product;
    for (int row = 0; row < 3; ++row) {
        product[row] = matrix[row][0] * vector[0] + matrix[row][1] * vector[1] + matrix[row][2] * vector[2];
    }
    return product;
}

inline double square_of(const Vector3& vector) {
    return vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2];
}

inline double length_of(const Vector3& vector) { return std::sqrt(square_of(vector)); }

// Quaternion product: the rotation `right` followed by `left`.
inline Quaternion product(const Quaternion& left, const Quaternion& right) {
    const auto [w, x, y, z] = left;
    const auto [a, b, c, d] = right;
    return {
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    };
}

// Inverse of a unit quaternion: world to body.
inline Quaternion inverse(const Quaternion& q) { return {q[0], -q[1], -q[2], -q[3]}; }

// The quaternion scaled to unit norm.
inline Quaternion normalised(const Quaternion& q) {
    const auto [w, x, y, z] = q;
    const double scale = 1.0 / std::sqrt(w * w + x * x + y * y + z * z);
    return {w * scale, x * scale, y * scale, z * scale};
}

// Unit quaternion of a rotation vector [rad] (the exponential map).
inline Quaternion from_rotation_vector(const Vector3& vector) {
    const auto [x, y, z] = vector;
    const double angle = std::sqrt(x * x + y * y + z * z);
    const SineAndCosine half = sine_and_cosine(0.5 * angle);
    const double scale = angle < SMALL_ANGLE ? 0.5 : half.sine / angle;
    return {half.cosine, scale * x, scale * y, scale * z};
}

// Shortest rotation vector [rad] of a unit quaternion of either sign (the logarithm map).
inline Vector3 to_rotation_vector(const Quaternion& q) {
    const double sign = q[0] < 0.0 ? -1.0 : 1.0;
    const double w = sign * q[0], x = sign * q[1], y = sign * q[2], z = sign * q[3];
    const double size = std::sqrt(x * x + y * y + z * z);
    const double scale = size < SMALL_ANGLE ? 2.0 : 2.0 * arctangent(size, w) / size;
    return {scale * x, scale * y, scale * z};
}

// Rotation matrix, body to world, of a unit quaternion.
inline Matrix3 rotation_matrix(const Quaternion& q) {
    const auto [w, x, y, z] = q;
    return {{
        {1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)},
        {2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)},
        {2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)},
    }};
}

// A vector of the world in body axes.
inline Vector3 into_body(const Matrix3& rotation, const Vector3& world) {
    Vector3 body;
    for (int axis = 0; axis < 3; ++axis) {
        body[axis] =
            rotation[0][axis] * world[0] + rotation[1][axis] * world[1] + rotation[2][axis] * world[2];
    }
    return body;
}

}  // namespace quadpi
