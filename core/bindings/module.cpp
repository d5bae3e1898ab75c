// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
#include <nanobind/nanobind.h>

namespace quadpi {
void bind_elementary(nanobind::module_& module);
void bind_estimator(nanobind::module_& module);
void bind_logs(nanobind::module_& module);
void bind_messages(nanobind::module_& module);
void bind_models(nanobind::module_& module);
void bind_change(nanobind::module_& module);
void bind_monitor(nanobind::module_& module);
void bind_screening(nanobind::module_& module);
void bind_physical(nanobind::module_& module);
void bind_signals(nanobind::module_& module);
void bind_simulation(nanobind::module_& module);
}  // namespace quadpi

NB_MODULE(_core, module) {
    // What a node holds when it is interrupted ends with its process; nobody needs a list of it.
    nanobind::set_leak_warnings(false);
    module.doc() = "The compiled core; quadpi_core/_core.pyi has its signatures.";
    module.attr("SOURCES") = QUADPI_SOURCES;
    quadpi::bind_elementary(module);
    quadpi::bind_estimator(module);
    quadpi::bind_logs(module);
    quadpi::bind_messages(module);
    quadpi::bind_signals(module);
    quadpi::bind_models(module);
    quadpi::bind_screening(module);
    quadpi::bind_change(module);
    quadpi::bind_monitor(module);
    quadpi::bind_physical(module);
    quadpi::bind_simulation(module);
}
