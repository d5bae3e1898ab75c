// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Matrices of fixed sizes. Sums run in the order of the indices, so that all processors give the same bits.
#pragma once

#include <algorithm>

#include "quadpi/rotations.hpp"

namespace quadpi {

template <std::size_t ROWS, std::size_t COLUMNS>
using Matrix = std::array<std::array<double, COLUMNS>, ROWS>;

// A B, into a matrix of its own.
template <std::size_t ROWS, std::size_t INNER, std::size_t COLUMNS>
Matrix<ROWS, COLUMNS> multiplied(const Matrix<ROWS, INNER>& left, const Matrix<INNER, COLUMNS>& right) {
    Matrix<ROWS, COLUMNS> result;
    for (std::size_t row = 0; row < ROWS; ++row) {
        for (std::size_t column = 0; column < COLUMNS; ++column) {
            result[row][column] = left[row][0] * right[0][column];
        }
        for (std::size_t inner = 1; inner < INNER; ++inner) {
            for (std::size_t column = 0; column < COLUMNS; ++column) {
                result[row][column] += left[row][inner] * right[inner][column];
            }
        }
    }
    return result;
}

template <std::size_t ROWS, std::size_t COLUMNS>
Matrix<COLUMNS, ROWS> transposed(const Matrix<ROWS, COLUMNS>& matrix) {
    Matrix<COLUMNS, ROWS> result;
    for (std::size_t row = 0; row < ROWS; ++row) {
        for (std::size_t column = 0; column < COLUMNS; ++column) {
            result[column][row] = matrix[row][column];
        }
    }
    return result;
}

// A + k B.
template <std::size_t ROWS, std::size_t COLUMNS>
Matrix<ROWS, COLUMNS> sum(
    const Matrix<ROWS, COLUMNS>& left, const Matrix<ROWS, COLUMNS>& right, double scale = 1.0
) {
    Matrix<ROWS, COLUMNS> result;
    for (std::size_t row = 0; row < ROWS; ++row) {
        for (std::size_t column = 0; column < COLUMNS; ++column) {
            result[row][column] = left[row][column] + scale * right[row][column];
        }
    }
    return result;
}

// Some rows of a matrix, from one on.
template <std::size_t COUNT, std::size_t ROWS, std::size_t COLUMNS>
Matrix<COUNT, COLUMNS> rows_of(const Matrix<ROWS, COLUMNS>& matrix, std::size_t first) {
    Matrix<COUNT, COLUMNS> rows;
    std::copy_n(matrix.begin() + first, COUNT, rows.begin());
    return rows;
}

template <std::size_t COUNT, std::size_t ROWS, std::size_t COLUMNS>
void set_rows(Matrix<ROWS, COLUMNS>& matrix, std::size_t first, const Matrix<COUNT, COLUMNS>& rows) {
    std::copy_n(rows.begin(), COUNT, matrix.begin() + first);
}

inline Vector3 scaled(double scale, const Vector3& vector) {
    return {scale * vector[0], scale * vector[1], scale * vector[2]};
}

// [v]×, so that [v]× x = v × x.
inline Matrix3 cross_matrix(const Vector3& v) {
    return {{{0.0, -v[2], v[1]}, {v[2], 0.0, -v[0]}, {-v[1], v[0], 0.0}}};
}

// Inverse of a matrix that has one, by its adjugate.
inline Matrix3 inverse_of(const Matrix3& matrix) {
    const Matrix3 cofactors{
        cross(matrix[1], matrix[2]), cross(matrix[2], matrix[0]), cross(matrix[0], matrix[1])
    };
    const double determinant =
        matrix[0][0] * cofactors[0][0] + matrix[0][1] * cofactors[0][1] + matrix[0][2] * cofactors[0][2];
    Matrix3 inverse = transposed(cofactors);
    for (Vector3& row : inverse) {
        for (double& number : row) {
            number /= determinant;
        }
    }
    return inverse;
}

// Right Jacobian of the exponential map: exp(v + δ) ≈ exp(v) exp(J δ).
inline Matrix3 right_jacobian(const Vector3& vector) {
    // Below this angle [rad] the series of sine and cosine are more exact than what is left of them.
    constexpr double small = 1e-4;
    const double angle = length_of(vector);
    const Matrix3 by = cross_matrix(vector), square = multiplied(by, by);
    const bool is_small = angle < small;
    const auto [height, along] = sine_and_cosine(angle);
    const double first = is_small ? 0.5 : (1.0 - along) / (angle * angle);
    const double second = (angle - height) / (angle * (angle * angle));
    Matrix3 jacobian;
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column) {
            const double last = is_small ? square[row][column] / 6.0 : second * square[row][column];
            jacobian[row][column] = (row == column ? 1.0 : 0.0) - first * by[row][column] + last;
        }
    }
    return jacobian;
}

}  // namespace quadpi
