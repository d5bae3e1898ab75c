// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// All axes of an ensemble evaluated together; see models/fitted_ensemble.py.
//
// Two loops compute the same sums. A block has its samples side by side in vector registers; a single sample,
// as in flight, has the hidden units side by side. Both take inputs and units in the same order and round at
// the same places, so live and replay agree bit for bit.
//
// Every x86-64 processor since 2013 has instructions for std::fma, but a build for all of them may not use
// them. Both loops are compiled twice, and the loader takes what the processor can run. The bits are the
// same: without such instructions, std::fma is a function of the C library.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "quadpi/models/evaluation.hpp"
#include "quadpi/models/regressors.hpp"

namespace quadpi {

// Samples whose inputs stay in the cache.
constexpr std::size_t ENSEMBLE_BLOCK = 256;
// Two banks of networks share the inputs of an axis: its members, and the noise network if it has one.
constexpr std::size_t MEMBERS = 0, NOISE_NETWORK = 1, BANKS = 2;
// Most outputs of a network: one for the target, two for its lower and upper bound.
constexpr std::size_t MOST_OUTPUTS = 2;
// One bank of networks; all zero where there is none.
//
// From `start` lie its weights: of the hidden layer (1 + inputs, networks × units) biases, then weights; of
// the outputs (outputs, networks, 1 + units) bias, then the weight of each unit. The scaling of inputs, and
// that of what members give, is in them.
struct Bank {
    std::int64_t inputs;
    std::int64_t units;  // of one network, an even number
    std::int64_t networks;
    std::int64_t outputs;
    std::int64_t start;
};

struct EnsembleAxis {
    std::array<Bank, BANKS> banks;
    double scale;       // of the target
    double floor;       // least noise or spread, in the target's own unit
    double share;       // weight of the members' disagreement
    double rms_spread;  // root mean square of the spread over the training samples
};

// The ensembles of a model.
struct Ensembles {
    Records<const Operation> operations;
    Records<const EnsembleAxis> axes;
    Records<const std::int64_t> source;  // by axis: rows of the program that are the inputs
    const double* weights;
};

// Memory for a block: the rows of the program, the activations of all hidden units of a bank, and the outputs
// (banks, outputs, networks, ENSEMBLE_BLOCK).
struct EnsembleScratch {
    double* rows;
    double* activations;
    double* outputs;
    std::size_t networks;  // most of any bank

    double* output(std::size_t bank, std::size_t k, std::size_t network) const {
        return outputs + ((bank * MOST_OUTPUTS + k) * networks + network) * ENSEMBLE_BLOCK;
    }
};

// A bank's tables, and the rows that are its inputs.
struct BankTables {
    BankTables(const Bank& bank, const double* weights, const std::int64_t* source)
        : inputs(static_cast<std::size_t>(bank.inputs)),
          units(static_cast<std::size_t>(bank.units)),
          networks(static_cast<std::size_t>(bank.networks)),
          outputs(static_cast<std::size_t>(bank.outputs)),
          hidden(weights + bank.start),
          source(source) {}

    std::size_t all_units() const { return networks * units; }
    const double* output(std::size_t k, std::size_t network) const {
        return hidden + (1 + inputs) * all_units() + (k * networks + network) * (1 + units);
    }

    std::size_t inputs, units, networks, outputs;
    const double* hidden;
    const std::int64_t* source;
};

// The larger of 0 and a number; NaN stays NaN.
inline double rectified(double value) { return value < 0.0 ? 0.0 : value; }

inline double softplus(double value) {
    return std::max(value, 0.0) + logarithm_of_1_plus(exponential(-std::abs(value)));
}

// Add N inputs of the first sample to the sums of all hidden units.
template <int N>
[[gnu::always_inline]] inline void add_inputs_to_units(
    const BankTables& bank, const Rows& rows, std::size_t first, double* __restrict sums
) {
    double input[N];
    const double* weights[N];
    for (int k = 0; k < N; ++k) {
        input[k] = *rows[bank.source[first + k]];
        weights[k] = bank.hidden + (1 + first + k) * bank.all_units();
    }
    for (std::size_t unit = 0; unit < bank.all_units(); ++unit) {
        double sum = sums[unit];
        for (int k = 0; k < N; ++k) {
            sum = std::fma(weights[k][unit], input[k], sum);
        }
        sums[unit] = sum;
    }
}

// Fill the outputs of one bank for the first sample, units side by side.
#if defined(__x86_64__)
[[gnu::target_clones("fma", "default")]]
#endif
inline void evaluate_one(
    const BankTables& bank, const Rows& rows, std::size_t place, const EnsembleScratch& scratch
) {
    double* sums = scratch.activations;
    std::copy_n(bank.hidden, bank.all_units(), sums);
    std::size_t d = 0;
    for (; d + 4 <= bank.inputs; d += 4) {
        add_inputs_to_units<4>(bank, rows, d, sums);
    }
    switch (bank.inputs - d) {
        case 3:
            add_inputs_to_units<3>(bank, rows, d, sums);
            break;
        case 2:
            add_inputs_to_units<2>(bank, rows, d, sums);
            break;
        case 1:
            add_inputs_to_units<1>(bank, rows, d, sums);
            break;
    }
    for (std::size_t k = 0; k < bank.outputs; ++k) {
        for (std::size_t network = 0; network < bank.networks; ++network) {
            const double *weights = bank.output(k, network), *own = sums + network * bank.units;
            double total = weights[0];
            for (std::size_t unit = 0; unit < bank.units; ++unit) {
                total = std::fma(weights[1 + unit], rectified(own[unit]), total);
            }
            *scratch.output(place, k, network) = total;
        }
    }
}

// Two hidden units of a network over a block: their sums so far, and what they add to the outputs.
struct UnitPair {
    const double *one_weights, *other_weights;  // bias, then those of the inputs, `stride` apart
    std::size_t stride;
    std::array<double, MOST_OUTPUTS> one_output, other_output;  // weights
    std::array<double*, MOST_OUTPUTS> outputs;                  // by sample
    std::array<double, ENSEMBLE_BLOCK> one, other;

    // Add N inputs of samples, the first ones to the biases, and after the last ones the units to OUTPUTS
    // outputs.
    template <int N, bool FIRST, int OUTPUTS>
    [[gnu::always_inline]] void add(const Rows& rows, const std::int64_t* source, std::size_t samples) {
        const double* inputs[N];
        double one_weight[N], other_weight[N];
        for (int k = 0; k < N; ++k) {
            inputs[k] = rows[source[k]];
            one_weight[k] = one_weights[(1 + k) * stride];
            other_weight[k] = other_weights[(1 + k) * stride];
        }
        const double one_bias = *one_weights, other_bias = *other_weights;
        const auto one_by = one_output, other_by = other_output;
        const auto written = outputs;
        double *const one_sums = one.data(), *const other_sums = other.data();
// No output is an input.
#pragma GCC ivdep
        for (std::size_t i = 0; i < samples; ++i) {
            double one_sum = FIRST ? one_bias : one_sums[i], other_sum = FIRST ? other_bias : other_sums[i];
            for (int k = 0; k < N; ++k) {
                one_sum = std::fma(one_weight[k], inputs[k][i], one_sum);
                other_sum = std::fma(other_weight[k], inputs[k][i], other_sum);
            }
            for (int k = 0; k < OUTPUTS; ++k) {
                const double with_one = std::fma(one_by[k], rectified(one_sum), written[k][i]);
                const double with_both = std::fma(other_by[k], rectified(other_sum), with_one);
                written[k][i] = with_both;
            }
            if (OUTPUTS == 0) {
                one_sums[i] = one_sum;
                other_sums[i] = other_sum;
            }
        }
        one_weights += N * stride;
        other_weights += N * stride;
    }

    // Add the last inputs, of which there are `count`.
    template <bool FIRST, int OUTPUTS>
    [[gnu::always_inline]] void add_last(
        const Rows& rows, const std::int64_t* source, std::size_t count, std::size_t samples
    ) {
        switch (count) {
            case 1:
                return add<1, FIRST, OUTPUTS>(rows, source, samples);
            case 2:
                return add<2, FIRST, OUTPUTS>(rows, source, samples);
            case 3:
                return add<3, FIRST, OUTPUTS>(rows, source, samples);
            case 4:
                return add<4, FIRST, OUTPUTS>(rows, source, samples);
            default:
                return add<5, FIRST, OUTPUTS>(rows, source, samples);
        }
    }

    // Add all inputs.
    template <int OUTPUTS>
    [[gnu::always_inline]] void add_all(
        const Rows& rows, const std::int64_t* source, std::size_t count, std::size_t samples
    ) {
        if (count <= 5) {
            return add_last<true, OUTPUTS>(rows, source, count, samples);
        }
        add<5, true, 0>(rows, source, samples);
        for (source += 5, count -= 5; count > 5; source += 5, count -= 5) {
            add<5, false, 0>(rows, source, samples);
        }
        add_last<false, OUTPUTS>(rows, source, count, samples);
    }
};

// Fill the outputs of one bank for a block, samples side by side, two units of a network at a time.
#if defined(__x86_64__)
[[gnu::target_clones("fma", "default")]]
#endif
inline void evaluate_block(
    const BankTables& bank,
    const Rows& rows,
    std::size_t block,
    std::size_t place,
    const EnsembleScratch& scratch
) {
    // Whole vector registers; what follows the samples in rows and outputs is of no matter.
    const std::size_t samples = (block + 3) / 4 * 4;
    UnitPair units;
    units.stride = bank.all_units();
    for (std::size_t network = 0; network < bank.networks; ++network) {
        for (std::size_t k = 0; k < bank.outputs; ++k) {
            units.outputs[k] = scratch.output(place, k, network);
            std::fill_n(units.outputs[k], samples, *bank.output(k, network));
        }
        for (std::size_t unit = 0; unit < bank.units; unit += 2) {
            units.one_weights = bank.hidden + network * bank.units + unit;
            units.other_weights = units.one_weights + 1;
            for (std::size_t k = 0; k < bank.outputs; ++k) {
                const double* weights = bank.output(k, network) + 1 + unit;
                units.one_output[k] = weights[0];
                units.other_output[k] = weights[1];
            }
            if (bank.outputs == 1) {
                units.add_all<1>(rows, bank.source, bank.inputs, samples);
            } else {
                units.add_all<MOST_OUTPUTS>(rows, bank.source, bank.inputs, samples);
            }
        }
    }
}

// Mean and variance (B - 1) of an output of the B members, by sample.
struct Moments {
    std::array<double, ENSEMBLE_BLOCK> mean, variance;

    void fill(const EnsembleScratch& scratch, std::size_t k, std::size_t networks, std::size_t samples) {
        const double count = static_cast<double>(networks);
        std::fill_n(mean.data(), samples, 0.0);
        std::fill_n(variance.data(), samples, 0.0);
        for (std::size_t network = 0; network < networks; ++network) {
            const double* output = scratch.output(MEMBERS, k, network);
            for (std::size_t i = 0; i < samples; ++i) {
                mean[i] += output[i];
            }
        }
        for (std::size_t i = 0; i < samples; ++i) {
            mean[i] /= count;
        }
        for (std::size_t network = 0; network < networks; ++network) {
            const double* output = scratch.output(MEMBERS, k, network);
            for (std::size_t i = 0; i < samples; ++i) {
                const double off = output[i] - mean[i];
                variance[i] += off * off;
            }
        }
        for (std::size_t i = 0; i < samples; ++i) {
            variance[i] /= count - 1.0;
        }
    }
};

// Fill the intervals of one axis, for samples from `start` on, from the outputs of both banks.
inline void fill_intervals(
    const EnsembleAxis& fitted,
    std::size_t axis,
    double factor,
    std::size_t start,
    std::size_t samples,
    const EnsembleScratch& scratch,
    const Evaluation& out
) {
    std::array<Moments, MOST_OUTPUTS> moments;
    const Bank& members = fitted.banks[MEMBERS];
    const auto outputs = static_cast<std::size_t>(members.outputs);
    for (std::size_t k = 0; k < outputs; ++k) {
        moments[k].fill(scratch, k, static_cast<std::size_t>(members.networks), samples);
    }
    const double* noise_output = scratch.output(NOISE_NETWORK, 0, 0);
    const auto& [lower, upper] = moments;
    for (std::size_t i = 0; i < samples; ++i) {
        double centre, spread;
        if (outputs == 1) {
            const double noise = fitted.scale * softplus(noise_output[i]) + fitted.floor;
            centre = lower.mean[i];
            spread = std::sqrt(fitted.share * lower.variance[i] + noise * noise);
        } else {
            centre = 0.5 * (lower.mean[i] + upper.mean[i]);
            const double outward =
                0.5 * fitted.share * (std::sqrt(lower.variance[i]) + std::sqrt(upper.variance[i]));
            spread = std::max(std::abs(0.5 * (upper.mean[i] - lower.mean[i]) + outward), fitted.floor);
        }
        out.fill(start + i, axis, centre, spread, factor, fitted.rms_spread);
    }
}

// The ensembles of a model, with room for a block; there is no leverage of theirs.
struct EnsembleEvaluator final : Evaluator {
    EnsembleEvaluator(const Ensembles& its_model, const EnsembleScratch& its_scratch)
        : model(its_model), scratch(its_scratch) {}

    Ensembles model;
    EnsembleScratch scratch;

    void evaluate(
        Records<const InputVector> inputs,
        Records<const Derivatives> derivatives,
        const Wrench& factors,
        const Evaluation& out
    ) override {
        const std::size_t most_inputs = model.source.size / AXES;
        for (std::size_t start = 0; start < inputs.size; start += ENSEMBLE_BLOCK) {
            const std::size_t samples = std::min(inputs.size - start, ENSEMBLE_BLOCK);
            const Rows rows(scratch.rows, samples == 1 ? 1 : ENSEMBLE_BLOCK);
            fill_rows(inputs.part(start, start + samples), model.operations, rows);
            for (std::size_t axis = 0; axis < AXES; ++axis) {
                const EnsembleAxis& fitted = model.axes[axis];
                if (fitted.banks[MEMBERS].networks == 0) {
                    continue;
                }
                for (std::size_t place = 0; place < BANKS; ++place) {
                    const BankTables bank(
                        fitted.banks[place], model.weights, model.source.data + axis * most_inputs
                    );
                    if (samples == 1) {
                        evaluate_one(bank, rows, place, scratch);
                    } else {
                        evaluate_block(bank, rows, samples, place, scratch);
                    }
                }
                fill_intervals(fitted, axis, factors[axis], start, samples, scratch, out);
            }
        }
        scale_by_density(derivatives, out);
    }
};

}  // namespace quadpi
