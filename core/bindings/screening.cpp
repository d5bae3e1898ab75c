// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls to judge samples.
#include <nanobind/nanobind.h>

#include "bindings/rotors.hpp"
#include "quadpi/messages/values.hpp"
#include "quadpi/monitor/data_quality.hpp"
#include "quadpi/screening/sample_order.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

void find_order(
    Records<const std::int64_t> time_ns,
    double hole_ns,
    Records<std::int64_t> rising,
    Records<std::int8_t> kinds,
    Records<std::int64_t> run_of
) {
    const std::size_t count = time_ns.size;
    require(rising.size == count && kinds.size == count && run_of.size == count, DIFFERENT);
    scan_order(time_ns, hole_ns, rising.data, kinds, run_of);
}

void bind_limits(nb::module_& module) {
    const std::pair<const char*, double> limits[] = {
        {"AIRSPEED_MAX_M_S", AIRSPEED_MAX_M_S},
        {"MEASURED_SPEED_MAX_M_S", MEASURED_SPEED_MAX_M_S},
        {"POSITION_MAX_M", POSITION_MAX_M},
        {"QUATERNION_NORM_TOLERANCE", QUATERNION_NORM_TOLERANCE},
        {"RATE_MAX_RAD_S", RATE_MAX_RAD_S},
        {"SPECIFIC_FORCE_MAX_M_S2", SPECIFIC_FORCE_MAX_M_S2},
        {"STANDARD_GRAVITY", STANDARD_GRAVITY},
        {"UNKNOWN_VARIANCE", UNKNOWN_VARIANCE},
    };
    for (const auto& [name, value] : limits) {
        module.attr(name) = value;
    }
    const std::pair<const char*, std::int64_t> stamps[] = {
        {"FLIGHT_MAX_NS", FLIGHT_MAX_NS},
        {"MAX_GAP_NS", MAX_GAP_NS},
        {"MAX_JUMP_BACK_NS", MAX_JUMP_BACK_NS},
        {"NO_STAMP", NO_STAMP},
    };
    for (const auto& [name, value] : stamps) {
        module.attr(name) = value;
    }
}

}  // namespace

void bind_screening(nb::module_& module) {
    bind_limits(module);
    module.attr("RISES") = static_cast<std::int64_t>(RISES);
    module.attr("LATE") = static_cast<std::int64_t>(LATE);
    module.attr("ALONE") = static_cast<std::int64_t>(ALONE);
    module.def("scan_order", &find_order);
    module.def("usable_imu", [](Records<const Vector3> rates, Records<const Vector3> specific_force) {
        return usable_imu(only(rates), only(specific_force));
    });
}

}  // namespace quadpi
