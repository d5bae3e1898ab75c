// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls of fitted models, but for those of physical terms.
#include <nanobind/nanobind.h>

#include "bindings/records.hpp"
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

void evaluate_polynomials(
    Inputs inputs,
    Operations operations,
    Records<const PolynomialAxis> axes,
    Records<const PolynomialTerm> terms,
    Records<const double> whitening,
    Records<double> memory,
    Records<const Wrench> factors,
    Records<Wrench> out
) {
    const Polynomials model{operations, axes, terms, whitening.data};
    const std::size_t longest = model.longest();
    require(out.size == 5 * inputs.size, DIFFERENT);
    require(axes.size == AXES && whitening.size == AXES * longest * longest, "tables of different sizes");
    const Rows rows = rows_in(memory, BASE_ROWS + operations.size, 1);
    evaluate(model, inputs, only(factors), rows, Evaluation::in(out, inputs.size));
}

void evaluate_ensembles(
    Inputs inputs,
    Operations operations,
    Records<const EnsembleAxis> axes,
    Records<const std::int64_t> source,
    Records<const double> weights,
    Records<double> rows,
    Records<double> activations,
    Records<double> outputs,
    Records<const Wrench> factors,
    Records<Wrench> out
) {
    require(out.size == 5 * inputs.size, DIFFERENT);
    require(axes.size == AXES, "tables of different sizes");
    rows_in(rows, BASE_ROWS + operations.size, ENSEMBLE_BLOCK);
    const std::size_t networks = outputs.size / (BANKS * MOST_OUTPUTS * ENSEMBLE_BLOCK);
    for (const EnsembleAxis& axis : axes) {
        for (const Bank& bank : axis.banks) {
            const BankTables tables(bank, weights.data, source.data);
            require(
                tables.networks <= networks && tables.all_units() <= activations.size &&
                    tables.output(tables.outputs, 0) <= weights.end(),
                "tables of different sizes"
            );
        }
    }
    const EnsembleScratch scratch{rows.data, activations.data, outputs.data, networks};
    evaluate(
        {operations, axes, source, weights.data},
        inputs,
        only(factors),
        scratch,
        Evaluation::in(out, inputs.size)
    );
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
    module.attr("BASE_ROWS") = BASE_ROWS;
    module.attr("ENSEMBLE_BLOCK") = ENSEMBLE_BLOCK;
    module.attr("GRAM_BLOCK") = GRAM_BLOCK;
    module.attr("MOST_OUTPUTS") = MOST_OUTPUTS;
    module.attr("TILE_ROWS") = TILE_ROWS;
    module.def("evaluate_regressors", &evaluate_regressors);
    module.def("evaluate_polynomials", &evaluate_polynomials);
    module.def("evaluate_ensembles", &evaluate_ensembles);
    module.def("add_to_gram", &add_to_gram, nb::call_guard<nb::gil_scoped_release>());
    module.def("distances_outside", &find_distances_outside);
}

}  // namespace quadpi
