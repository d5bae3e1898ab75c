// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What models give of samples; see `Evaluation` of models/model_kind.py.
#pragma once

#include "quadpi/inputs.hpp"
#include "quadpi/records.hpp"
#include "quadpi/signals/wrench.hpp"

namespace quadpi {

// Arrays of N samples, zero for axes that the model does not hold.
struct Evaluation {
    Wrench* predicted;  // N and Nm, body forward-right-down
    Wrench* lower;
    Wrench* upper;
    Wrench* leverage;
    Wrench* relative_width;

    // Those of `samples` samples, one after the other in an array (5, N, 6).
    static Evaluation in(Records<Wrench> array, std::size_t samples) {
        Wrench* first = array.data;
        return {first, first + samples, first + 2 * samples, first + 3 * samples, first + 4 * samples};
    }

    // Fill all but the leverage of a sample: the interval is `factor` spreads to each side.
    void fill(
        std::size_t sample, std::size_t axis, double centre, double spread, double factor, double rms_spread
    ) const {
        predicted[sample][axis] = centre;
        lower[sample][axis] = centre - factor * spread;
        upper[sample][axis] = centre + factor * spread;
        relative_width[sample][axis] = spread / rms_spread;
    }
};

// A fitted model with room to work in: it allocates nothing.
class Evaluator {
public:
    virtual ~Evaluator() = default;

    // Whether samples need derivatives; else there may be none.
    virtual bool uses_derivatives() const { return false; }

    // Fill the evaluation of samples, which is zero, for the axes held.
    //
    // factors: half width of each axis' interval per unit of spread.
    virtual void evaluate(
        Records<const InputVector> inputs,
        Records<const Derivatives> derivatives,
        const Wrench& factors,
        const Evaluation& out
    ) = 0;
};

}  // namespace quadpi
