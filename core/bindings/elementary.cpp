// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls of the elementary functions: each over an array.
#include "quadpi/elementary.hpp"

#include <nanobind/nanobind.h>

#include "bindings/records.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

template <double (*function)(double)>
void each(Records<const double> arguments, Records<double> values) {
    require(values.size == arguments.size, DIFFERENT);
    for (std::size_t i = 0; i < arguments.size; ++i) {
        values[i] = function(arguments[i]);
    }
}

void each_arctangent(Records<const double> y, Records<const double> x, Records<double> values) {
    require(values.size == y.size && values.size == x.size, DIFFERENT);
    for (std::size_t i = 0; i < y.size; ++i) {
        values[i] = arctangent(y[i], x[i]);
    }
}

}  // namespace

void bind_elementary(nb::module_& module) {
    module.def("sine", &each<sine>);
    module.def("cosine", &each<cosine>);
    module.def("arctangent", &each_arctangent);
    module.def("exponential", &each<exponential>);
    module.def("exponential_minus_1", &each<exponential_minus_1>);
    module.def("hyperbolic_tangent", &each<hyperbolic_tangent>);
    module.def("logarithm_of_1_plus", &each<logarithm_of_1_plus>);
}

}  // namespace quadpi
