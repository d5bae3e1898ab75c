// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls to read and write messages. Lengths that a file may have wrong are checked here.
#include <nanobind/nanobind.h>

#include <cstring>

#include "bindings/records.hpp"
#include "quadpi/messages/mounting.hpp"
#include "quadpi/messages/rotor_messages.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

using Stamps = Records<const std::int64_t>;
using Bytes = Records<const std::uint8_t>;

void require(bool holds, const char* what) {
    if (!holds) {
        throw nb::value_error(what);
    }
}

// Whether a span of bytes lies in a buffer.
bool lies_in(std::int64_t start, std::int64_t length, std::size_t size) {
    return start >= 0 && length >= 0 && static_cast<std::uint64_t>(start) <= size &&
           static_cast<std::uint64_t>(length) <= size - static_cast<std::size_t>(start);
}

// Copy spans of bytes from one buffer into another.
void copy_spans(
    Bytes source, Stamps source_starts, Records<std::uint8_t> target, Stamps target_starts, Stamps lengths
) {
    require(source_starts.size == lengths.size && target_starts.size == lengths.size, "spans of different numbers");
    for (std::size_t i = 0; i < lengths.size; ++i) {
        const bool inside = lies_in(source_starts[i], lengths[i], source.size) &&
                            lies_in(target_starts[i], lengths[i], target.size);
        require(inside, "a message outside its buffer");
        if (lengths[i] > 0) {
            std::memcpy(
                target.data + target_starts[i], source.data + source_starts[i], static_cast<std::size_t>(lengths[i])
            );
        }
    }
}

void move_mounted(Records<MountedImu> imu, Stamps time_ns, Records<Vector3> rates, Records<Vector3> force) {
    require(imu.size == 1 && rates.size == time_ns.size && force.size == time_ns.size, "samples of different numbers");
    for (std::size_t k = 0; k < time_ns.size; ++k) {
        move_to_body(imu[0], time_ns[k], rates[k], force[k]);
    }
}

// The arrays of reports, held as long as a call lasts.
struct HeldReports {
    explicit HeldReports(nb::handle reports)
        : rpm(reports, "rpm"), marks(reports, "marks"), verdict(reports, "verdict") {}

    EscReports reports(std::size_t messages) const {
        const EscReports found{rpm.all(), marks.all(), verdict.all()};
        require(found.of(messages), "reports of different numbers");
        return found;
    }

    Field<EscSpeeds> rpm;
    Field<EscNumbers> marks;
    Field<std::uint8_t> verdict;
};

void take_numbered_escs(
    Records<const std::int64_t> counts,
    Records<const double> rpm,
    Records<const std::int64_t> marks,
    Records<const EscNumbers> wanted,
    nb::handle reports
) {
    const EscArray array{rpm, marks};
    require(check(counts, array), "reports of other numbers than their messages count");
    require(wanted.size == 1, "not four ESCs");
    for (const std::int64_t number : wanted[0]) {
        require(number >= 0, "a negative number of an ESC");
    }
    const HeldReports held(reports);
    EscReports found = held.reports(counts.size);
    take_numbered(counts, array, wanted[0], found);
}

void take_escs_of_motors(
    Records<const std::int64_t> functions,
    Records<const double> rpm,
    Records<const std::int64_t> marks,
    Records<const std::int64_t> online,
    Records<const EscNumbers> wanted,
    nb::handle reports
) {
    require(rpm.size == functions.size && marks.size == functions.size, "reports of different numbers");
    require(wanted.size == 1, "not four motors");
    const HeldReports held(reports);
    EscReports found = held.reports(online.size);
    take_of_motors(functions, {rpm, marks}, online, wanted[0], found);
}

void judge_esc_news(nb::handle reports, Records<EscMemory> memory) {
    const Field<const std::int64_t> time_ns(reports, "time_ns");
    const Field<const EscNumbers> marks(reports, "marks");
    const Field<std::uint8_t> verdict(reports, "verdict");
    const std::size_t messages = time_ns.all().size;
    require(marks.all().size == messages && verdict.all().size == messages, "reports of different numbers");
    require(memory.size == 1, "not one memory of ESCs");
    for (std::size_t n = 0; n < messages; ++n) {
        std::uint8_t& found = verdict.all()[n];
        if (found == SAMPLE) {
            found = judge_news(time_ns.all()[n], marks.all()[n], memory[0]);
        }
    }
}

}  // namespace

void bind_messages(nb::module_& module) {
    module.attr("FIRST_MOTOR") = FIRST_MOTOR;
    module.attr("LAST_MOTOR") = LAST_MOTOR;
    module.attr("MOUNTING_LAG_S") = MOUNTING_LAG_S;
    module.def("copy_spans", &copy_spans);
    module.def("move_mounted", &move_mounted);
    module.def("take_numbered_escs", &take_numbered_escs);
    module.def("take_escs_of_motors", &take_escs_of_motors);
    module.def("judge_esc_news", &judge_esc_news);
}

}  // namespace quadpi
