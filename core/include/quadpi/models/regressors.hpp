// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Programs that evaluate polynomial regressors; models/regressors.py compiles them.
#pragma once

#include <cmath>
#include <cstdint>

#include "quadpi/inputs.hpp"
#include "quadpi/records.hpp"

namespace quadpi {

// Rows before those of the operations: the constant 1, the inputs and their absolute values.
constexpr std::size_t BASE_ROWS = 1 + 2 * INPUTS;

// One more row: the product of two earlier ones, or their weighted sum where a weight is set.
struct Operation {
    std::int64_t first;
    std::int64_t second;
    double first_weight;
    double second_weight;
};

// The rows of a program, each the values of one product or sum for some samples.
class Rows {
public:
    Rows(double* numbers, std::size_t samples) : numbers_(numbers), samples_(samples) {}

    double* operator[](std::size_t row) const { return numbers_ + row * samples_; }
    std::size_t samples() const { return samples_; }

private:
    double* numbers_;
    std::size_t samples_;
};

// Fill the rows of a program for the first samples, as many as there are inputs.
inline void fill_rows(
    Records<const InputVector> inputs, Records<const Operation> operations, const Rows& rows
) {
    const std::size_t count = inputs.size;
    for (std::size_t i = 0; i < count; ++i) {
        rows[0][i] = 1.0;
    }
    for (std::size_t j = 0; j < INPUTS; ++j) {
        double *value = rows[1 + j], *size = rows[1 + INPUTS + j];
        for (std::size_t i = 0; i < count; ++i) {
            value[i] = inputs[i][j];
            size[i] = std::abs(inputs[i][j]);
        }
    }
    double* out = rows[BASE_ROWS];
    for (const Operation& operation : operations) {
        const double *first = rows[operation.first], *second = rows[operation.second];
        const double first_weight = operation.first_weight, second_weight = operation.second_weight;
        if (first_weight == 0.0) {
            for (std::size_t i = 0; i < count; ++i) {
                out[i] = first[i] * second[i];
            }
        } else {
            for (std::size_t i = 0; i < count; ++i) {
                out[i] = first_weight * first[i] + second_weight * second[i];
            }
        }
        out += rows.samples();
    }
}

}  // namespace quadpi
