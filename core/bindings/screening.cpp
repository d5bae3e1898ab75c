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

}  // namespace

void bind_screening(nb::module_& module) {
    NAME_CONSTANTS(module, AIRSPEED_MAX_M_S, MEASURED_SPEED_MAX_M_S, POSITION_MAX_M);
    NAME_CONSTANTS(module, QUATERNION_NORM_TOLERANCE, RATE_MAX_RAD_S, SPECIFIC_FORCE_MAX_M_S2);
    NAME_CONSTANTS(module, STANDARD_GRAVITY, UNKNOWN_VARIANCE, FLIGHT_MAX_NS, MAX_GAP_NS, MAX_JUMP_BACK_NS);
    NAME_CONSTANTS(module, NO_STAMP);
    NAME_CONSTANTS(module, RISES, LATE, ALONE);
    module.def("scan_order", &find_order);
    module.def("usable_imu", [](Records<const Vector3> rates, Records<const Vector3> specific_force) {
        return usable_imu(only(rates), only(specific_force));
    });
}

}  // namespace quadpi
