// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls of fitted models, but for those of physical terms.
#include <nanobind/nanobind.h>

#include "bindings/held_model.hpp"
#include "quadpi/models/ensembles.hpp"
#include "quadpi/models/gram.hpp"
#include "quadpi/models/polynomials.hpp"
#include "quadpi/monitor/alarm.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

using Inputs = Records<const InputVector>;
using Operations = Records<const Operation>;

// The rows of a program in memory that Python allocated.
Rows rows_in(Records<double> memory, std::size_t rows, std::size_t samples) {
    require(memory.size >= rows * samples, "no room for the rows of the program");
    return {memory.data, samples};
}

void evaluate_regressors(
    Inputs inputs,
    Operations operations,
    Records<const std::int64_t> outputs,
    Records<double> memory,
    Records<double> values
) {
    require(values.size == inputs.size * outputs.size, DIFFERENT);
    const std::size_t rows_needed = BASE_ROWS + operations.size, block = memory.size / rows_needed;
    const Rows rows = rows_in(memory, rows_needed, std::max<std::size_t>(block, 1));
    for (std::size_t start = 0; start < inputs.size; start += block) {
        const std::size_t stop = std::min(inputs.size, start + block);
        fill_rows(inputs.part(start, stop), operations, rows);
        double* value = values.data + start * outputs.size;
        for (std::size_t i = 0; i < stop - start; ++i) {
            for (const std::int64_t output : outputs) {
                *value++ = rows[output][i];
            }
        }
    }
}

// The arrays of `FittedPolynomials`.
class HeldPolynomials final : public HeldModel {
public:
    explicit HeldPolynomials(nb::object its_arrays) : HeldModel(its_arrays) {
        const std::size_t longest = model.model.longest();
        require(
            axes.all().size == AXES && whitening.all().size == AXES * longest * longest &&
                longest % TERMS_TOGETHER == 0,
            "tables of different sizes"
        );
    }

    Evaluator& evaluator() override { return model; }

private:
    const Field<const Operation> operations{arrays, "operations"};
    const Field<const FittedAxis> axes{arrays, "axes"};
    const Field<const PolynomialTerm> terms{arrays, "terms"};
    const Field<const double> whitening{arrays, "whitening"};
    const Field<double> memory{arrays, "rows"};
    PolynomialEvaluator model{
        {operations.all(), axes.all(), terms.all(), whitening.all().data},
        rows_in(memory.all(), BASE_ROWS + operations.all().size, 1)
    };
};

// The arrays of `FittedEnsembles`.
class HeldEnsembles final : public HeldModel {
public:
    explicit HeldEnsembles(nb::object its_arrays) : HeldModel(its_arrays) {
        require(axes.all().size == AXES, "tables of different sizes");
        for (const EnsembleAxis& axis : axes.all()) {
            for (const Bank& bank : axis.banks) {
                const BankTables tables(bank, weights.all().data, source.all().data);
                require(
                    tables.networks <= model.scratch.networks && tables.units % 2 == 0 &&
                        (tables.networks == 0 || tables.inputs > 0) && tables.outputs <= MOST_OUTPUTS &&
                        tables.all_units() <= activations.all().size &&
                        tables.output(tables.outputs, 0) <= weights.all().end(),
                    "tables of different sizes"
                );
            }
        }
    }

    Evaluator& evaluator() override { return model; }

private:
    const Field<const Operation> operations{arrays, "operations"};
    const Field<const EnsembleAxis> axes{arrays, "axes"};
    const Field<const std::int64_t> source{arrays, "source"};
    const Field<const double> weights{arrays, "weights"};
    const Field<double> rows{arrays, "rows"}, activations{arrays, "activations"}, outputs{arrays, "outputs"};
    EnsembleEvaluator model{
        {operations.all(), axes.all(), source.all(), weights.all().data},
        {
            rows_in(rows.all(), BASE_ROWS + operations.all().size, ENSEMBLE_BLOCK)[0],
            activations.all().data,
            outputs.all().data,
            outputs.all().size / (BANKS * MOST_OUTPUTS * ENSEMBLE_BLOCK),
        }
    };
};

// Fill predicted, lower, upper, leverage and relative width of `out` (5, N, 6) for the axes held.
void evaluate_held(
    HeldModel& model,
    Inputs inputs,
    Records<const Derivatives> derivatives,
    Records<const Wrench> factors,
    Records<Wrench> out
) {
    Evaluator& evaluator = model.evaluator();
    require(out.size == 5 * inputs.size, DIFFERENT);
    require(derivatives.size == inputs.size || !evaluator.uses_derivatives(), DIFFERENT);
    evaluator.evaluate(inputs, derivatives, only(factors), Evaluation::in(out, inputs.size));
}

void add_to_gram(
    Inputs inputs,
    Records<const double> target,
    Operations operations,
    Records<const std::int64_t> factors,
    Records<double> memory,
    Records<double> sums
) {
    require(target.size == inputs.size, DIFFERENT);
    require(
        factors.size % TILE_ROWS == 0 && sums.size == factors.size * factors.size, "tables of different sizes"
    );
    const Rows rows = rows_in(memory, BASE_ROWS + operations.size + 1, GRAM_BLOCK);
    add_samples(inputs, target.data, operations, factors, rows, sums.data);
}

void find_distances_outside(
    Inputs inputs,
    Records<const InputVector> lower,
    Records<const InputVector> upper,
    Records<const InputVector> width,
    Records<InputVector> out
) {
    require(out.size == inputs.size, DIFFERENT);
    for (std::size_t i = 0; i < inputs.size; ++i) {
        for (int k = 0; k < INPUTS; ++k) {
            out[i][k] =
                distance_outside(inputs[i][k], only(lower)[k], only(upper)[k], only(width)[k], IS_COSINE[k]);
        }
    }
}

}  // namespace

void bind_models(nb::module_& module) {
    NAME_CONSTANTS(module, BASE_ROWS, ENSEMBLE_BLOCK, GRAM_BLOCK, MOST_OUTPUTS, TILE_ROWS);
    module.def("evaluate_regressors", &evaluate_regressors);
    bind_held<HeldModel>(module, "Model");
    module.attr("TERMS_TOGETHER") = TERMS_TOGETHER;
    nb::class_<HeldPolynomials, HeldModel>(module, "Polynomials").def(nb::init<nb::object>());
    nb::class_<HeldEnsembles, HeldModel>(module, "Ensembles").def(nb::init<nb::object>());
    module.def("evaluate", &evaluate_held);
    module.def("add_to_gram", &add_to_gram, nb::call_guard<nb::gil_scoped_release>());
    module.def("distances_outside", &find_distances_outside);
}

}  // namespace quadpi
