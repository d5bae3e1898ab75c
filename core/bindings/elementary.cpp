// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls of the elementary functions: each over an array.
#include "quadpi/elementary.hpp"

#include <nanobind/nanobind.h>

#include "bindings/records.hpp"

namespace nb = nanobind;

namespace quadpi {

void bind_elementary(nb::module_& module) {
    module.def("sine", over_rows(&sine));
    module.def("cosine", over_rows(&cosine));
    module.def("arctangent", over_rows(&arctangent));
    module.def("exponential", over_rows(&exponential));
    module.def("hyperbolic_tangent", over_rows(&hyperbolic_tangent));
}

}  // namespace quadpi
