// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Fitted polynomials, one sample after the other; see models/fitted_polynomial.py.
#pragma once

#include <array>

#include "quadpi/models/evaluation.hpp"
#include "quadpi/models/regressors.hpp"

namespace quadpi {

// One term of an axis.
struct PolynomialTerm {
    std::int64_t row;  // of the program
    double coefficient;
};

// Terms whose sums are made side by side, each in its own order; tables are padded to whole groups by zeros.
constexpr std::size_t TERMS_TOGETHER = 4;

// The polynomials of a model, their tables padded to the longest.
struct Polynomials {
    Records<const Operation> operations;
    Records<const FittedAxis> axes;
    Records<const PolynomialTerm> terms;  // by axis
    const double* whitening;              // by axis: lower triangular W, with leverage h = |W z|²

    std::size_t longest() const { return terms.size / AXES; }
};

// The polynomials of a model, with room for the rows of one sample.
struct PolynomialEvaluator final : Evaluator {
    PolynomialEvaluator(const Polynomials& its_model, const Rows& its_rows)
        : model(its_model), rows(its_rows) {}

    Polynomials model;
    Rows rows;

    void evaluate(
        Records<const InputVector> inputs,
        Records<const Derivatives> derivatives,
        const Wrench& factors,
        const Evaluation& out
    ) override {
        const std::size_t longest = model.longest();
        for (std::size_t i = 0; i < inputs.size; ++i) {
            fill_rows(inputs.part(i, i + 1), model.operations, rows);
            for (std::size_t axis = 0; axis < AXES; ++axis) {
                const FittedAxis& fitted = model.axes[axis];
                const PolynomialTerm* terms = model.terms.data + axis * longest;
                const double* whitening = model.whitening + axis * longest * longest;
                const auto size = static_cast<std::size_t>(fitted.size);
                if (size == 0) {
                    continue;
                }
                double predicted = 0.0, leverage = 0.0;
                for (std::size_t a = 0; a < size; a += TERMS_TOGETHER) {
                    std::array<double, TERMS_TOGETHER> whitened{};
                    for (std::size_t b = 0; b < a + TERMS_TOGETHER; ++b) {
                        const double value = *rows[terms[b].row];
                        for (std::size_t k = 0; k < TERMS_TOGETHER; ++k) {
                            whitened[k] += whitening[(a + k) * longest + b] * value;
                        }
                    }
                    for (std::size_t k = 0; k < TERMS_TOGETHER; ++k) {
                        predicted += terms[a + k].coefficient * *rows[terms[a + k].row];
                        leverage += whitened[k] * whitened[k];
                    }
                }
                out.fill(i, axis, predicted, leverage, factors[axis], fitted, inputs[i]);
            }
        }
        scale_by_density(derivatives, out);
    }
};

}  // namespace quadpi
