// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What models give of samples; see `Evaluation` of models/model_kind.py.
#pragma once

#include "quadpi/inputs.hpp"
#include "quadpi/records.hpp"
#include "quadpi/signals/wrench.hpp"

namespace quadpi {

// One axis of a model by least squares; its spread is √(1 + κ h + γ V²) of the leverage h and the airspeed V.
struct FittedAxis {
    std::int64_t size;  // terms, 0 where the axis is not held
    double inflation;   // κ
    double growth;      // γ [s²/m²]
    double rms_spread;  // root mean square of the spread over the training samples
};

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

    // Fill all of a sample, whose velocity comes first in its inputs, by a fitted axis.
    void fill(
        std::size_t sample,
        std::size_t axis,
        double centre,
        double its_leverage,
        double factor,
        const FittedAxis& fitted,
        const InputVector& inputs
    ) const {
        const double u = inputs[0], v = inputs[1], w = inputs[2], speed_squared = u * u + v * v + w * w;
        const double spread =
            std::sqrt(1.0 + fitted.inflation * its_leverage + fitted.growth * speed_squared);
        fill(sample, axis, centre, spread, factor, fitted.rms_spread);
        leverage[sample][axis] = its_leverage;
    }
};

// Scale, by the density of the air, what a model says that does not know of it; no interval gets narrower.
//
// At the same velocities and rotor speeds the wrench of the air goes with its density.
inline void scale_by_density(Records<const Derivatives> derivatives, const Evaluation& out) {
    for (std::size_t i = 0; i < derivatives.size; ++i) {
        if (derivatives[i].density_excess == 0.0) {
            continue;
        }
        const double ratio = 1.0 + derivatives[i].density_excess, widened = std::max(1.0, ratio);
        for (int axis = 0; axis < AXES; ++axis) {
            double &centre = out.predicted[i][axis], &lower = out.lower[i][axis], &upper = out.upper[i][axis];
            const double below = widened * (centre - lower), above = widened * (upper - centre);
            centre *= ratio;
            lower = centre - below, upper = centre + above;
            out.relative_width[i][axis] *= widened;
        }
    }
}

// Widen the intervals of a sample by what is independent of their own spread.
//
// added: squares of the half widths that it has alone, N² and (Nm)².
inline void widen(const Wrench& added, const Evaluation& out, std::size_t sample) {
    for (int axis = 0; axis < AXES; ++axis) {
        if (added[axis] == 0.0) {
            continue;
        }
        const double centre = out.predicted[sample][axis];
        double &lower = out.lower[sample][axis], &upper = out.upper[sample][axis];
        const double below = centre - lower, above = upper - centre, width = upper - lower;
        lower = centre - std::sqrt(below * below + added[axis]);
        upper = centre + std::sqrt(above * above + added[axis]);
        if (width > 0.0) {
            out.relative_width[sample][axis] *= (upper - lower) / width;
        }
    }
}

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
