// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls to read and write messages. Lengths that a file may have wrong are checked here.
#include <nanobind/nanobind.h>

#include <cstring>

#include "bindings/records.hpp"
#include "quadpi/messages/mounting.hpp"
#include "quadpi/messages/rotor_messages.hpp"
#include "quadpi/messages/values.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

using Stamps = Records<const std::int64_t>;
using Bytes = Records<const std::uint8_t>;

// Whether a span of bytes lies in a buffer.
bool lies_in(std::int64_t start, std::int64_t length, std::size_t size) {
    return start >= 0 && length >= 0 && static_cast<std::uint64_t>(start) <= size &&
           static_cast<std::uint64_t>(length) <= size - static_cast<std::size_t>(start);
}

// Copy spans of bytes from one buffer into another.
void copy_spans(
    Bytes source, Stamps source_starts, Records<std::uint8_t> target, Stamps target_starts, Stamps lengths
) {
    require_each(lengths.size, source_starts, target_starts);
    for (std::size_t i = 0; i < lengths.size; ++i) {
        const bool inside = lies_in(source_starts[i], lengths[i], source.size) &&
                            lies_in(target_starts[i], lengths[i], target.size);
        require(inside, "a message outside its buffer");
        if (lengths[i] > 0) {
            std::memcpy(
                target.data + target_starts[i],
                source.data + source_starts[i],
                static_cast<std::size_t>(lengths[i])
            );
        }
    }
}

void move_mounted(Records<MountedImu> imu, Stamps time_ns, Records<Vector3> rates, Records<Vector3> force) {
    require(imu.size == 1 && rates.size == time_ns.size && force.size == time_ns.size, DIFFERENT);
    for (std::size_t k = 0; k < time_ns.size; ++k) {
        move_to_body(imu[0], time_ns[k], rates[k], force[k]);
    }
}

// A function that reads a message as one of arrays: gives the first row that is no rotation, else -1.
template <class... T>
auto first_wrong(bool (*read)(T&...)) {
    return [read](Records<T>... arrays) {
        std::int64_t first = -1, row = 0;
        for_rows(
            [&](T&... records) {
                if (!read(records...) && first < 0) {
                    first = row;
                }
                ++row;
            },
            arrays...
        );
        return first;
    };
}

bool read_pose_values(const PoseNumbers& values, Vector3& position, Quaternion& attitude) {
    return read_pose(values.data(), position, attitude);
}

Vector3 wind_of(const Vector3& values) { return world_of(values.data()); }

void twist_values(Records<const TwistNumbers> values, bool in_body, Records<Vector3> velocity) {
    const auto axes_of = in_body ? &body_of : &world_of;
    for_rows([&](auto& twist, Vector3& own) { own = axes_of(twist.data()); }, values, velocity);
}

void odometry_values(
    Records<const Vector3> position,
    Records<const Quaternion> attitude,
    Records<const Vector3> velocity,
    Records<const Vector3> rates,
    Records<const Matrix6> pose_covariance,
    Records<const Matrix6> twist_covariance,
    Records<OdometryNumbers> values
) {
    require_each(values.size, position, attitude, velocity, rates, pose_covariance, twist_covariance);
    for (std::size_t row = 0; row < values.size; ++row) {
        const Motion motion{attitude[row], velocity[row], rates[row], {}};
        write_odometry({0, position[row], motion, pose_covariance[row], twist_covariance[row]}, values[row]);
    }
}

// wrenches: (5, N) predicted, lower, upper, measured and relative width; those from `first` on are written.
void prediction_values(Records<const Wrench> wrenches, std::size_t first, Records<PredictionNumbers> values) {
    const std::size_t rows = wrenches.size / 5;
    require(wrenches.size == 5 * rows && first <= rows && values.size <= rows - first, DIFFERENT);
    for (std::size_t i = 0; i < values.size; ++i) {
        const Wrench* own = &wrenches[first + i];
        write_prediction({own[0], own[rows], own[2 * rows], own[3 * rows], own[4 * rows]}, values[i]);
    }
}

using ReportFields = std::tuple<Stamps, Records<double>, Records<std::int64_t>, Records<std::uint8_t>>;

EscReports reports_of(const ReportFields& fields, std::size_t messages, std::size_t rotors) {
    const auto& [time_ns, rpm, marks, verdict] = fields;
    const EscReports found{rpm, marks, verdict};
    require(time_ns.size == messages && found.of(messages, rotors), "reports of different numbers");
    return found;
}

void take_numbered_escs(
    Records<const std::int64_t> counts,
    Records<const double> rpm,
    Records<const std::int64_t> marks,
    Records<const std::int64_t> wanted,
    const ReportFields& reports
) {
    const EscArray array{rpm, marks};
    require(check(counts, array), "reports of other numbers than their messages count");
    require(wanted.size > 0, "no ESCs");
    for (const std::int64_t number : wanted) {
        require(number >= 0, "a negative number of an ESC");
    }
    EscReports found = reports_of(reports, counts.size, wanted.size);
    take_numbered(counts, array, wanted, found);
}

void take_escs_of_motors(
    Records<const std::int64_t> functions,
    Records<const double> rpm,
    Records<const std::int64_t> marks,
    Records<const std::int64_t> online,
    Records<const std::int64_t> wanted,
    const ReportFields& reports
) {
    require(rpm.size == functions.size && marks.size == functions.size, "reports of different numbers");
    EscReports found = reports_of(reports, online.size, wanted.size);
    take_of_motors(functions, {rpm, marks}, online, wanted, found);
}

void judge_esc_news(const ReportFields& reports, Records<EscMemory> memory) {
    const auto& [time_ns, rpm, all_marks, verdict] = reports;
    const Records<const std::int64_t> marks{all_marks.data, all_marks.size};
    const std::size_t messages = time_ns.size;
    const std::size_t rotors = messages > 0 ? marks.size / messages : 0;
    reports_of(reports, messages, rotors);
    require(rotors <= ROTORS_MAX, "more rotors than are known");
    require(memory.size == 1, "not one memory of ESCs");
    for (std::size_t n = 0; n < messages; ++n) {
        if (verdict[n] == SAMPLE) {
            verdict[n] = judge_news(time_ns[n], marks.part(n * rotors, (n + 1) * rotors), memory[0]);
        }
    }
}

}  // namespace

void bind_messages(nb::module_& module) {
    NAME_CONSTANTS(module, FIRST_MOTOR, LAST_MOTOR, MOUNTING_LAG_S, NORM_TOLERANCE);
    module.attr("ODOMETRY_VALUES") = OdometryNumbers{}.size();
    module.attr("PREDICTION_VALUES") = PredictionNumbers{}.size();
    module.def("copy_spans", &copy_spans);
    module.def("move_mounted", &move_mounted);
    module.def("take_numbered_escs", &take_numbered_escs);
    module.def("take_escs_of_motors", &take_escs_of_motors);
    module.def("judge_esc_news", &judge_esc_news);
    module.def("imu_values", over_rows(&read_imu));
    module.def("pose_values", first_wrong(&read_pose_values));
    module.def("state_values", first_wrong(&read_odometry));
    module.def("wind_values", over_rows(&wind_of));
    module.def("twist_values", &twist_values);
    module.def("odometry_values", &odometry_values);
    module.def("fill_odometry", over_rows(&write_odometry));
    module.def("prediction_values", &prediction_values);
}

}  // namespace quadpi
