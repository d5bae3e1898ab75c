// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What Python calls of the evidence that a vehicle has changed.
#include <nanobind/nanobind.h>

#include "bindings/records.hpp"
#include "bindings/rotors.hpp"
#include "quadpi/monitor/alarm.hpp"

namespace nb = nanobind;

namespace quadpi {
namespace {

// Whitened residuals (N,) of one axis of a flight, their standard deviations before they were seen, and what
// a constant of 1 would add to them, and the loudness before them.
void whiten_blocks(
    Records<const AxisNoise> noise,
    Records<const double> residuals,
    Records<const std::int64_t> numbers,
    Records<double> errors,
    Records<double> spreads,
    Records<double> ones,
    Records<double> loudness
) {
    const std::size_t count = residuals.size;
    require(numbers.size == count && errors.size == count, DIFFERENT);
    require(spreads.size == count && ones.size == count && loudness.size == count, DIFFERENT);
    whiten(only(noise), residuals, numbers, errors, spreads, ones, loudness);
}

// The evidence (N,) after each block of a flight.
void gather_evidence(
    Records<const ChangeLimits> limits,
    Records<const RotorGeometry> rotors,
    Records<const ChangeBlock> blocks,
    Records<Change> memory,
    Records<double> evidence
) {
    require(evidence.size == blocks.size, DIFFERENT);
    checked_rotors(only(rotors).rotors);
    for (std::size_t row = 0; row < blocks.size; ++row) {
        only(memory).within.sum = blocks[row];
        take_block(only(limits), only(rotors), only(memory));
        evidence[row] = only(memory).evidence;
    }
}

}  // namespace

void bind_change(nb::module_& module) {
    module.attr("BLOCK_S") = 1e-9 * static_cast<double>(BLOCK_NS);
    NAME_CONSTANTS(module, BLOCK_FILLED_S, ONSETS, DIRECTIONS, SIZES, NOTHING, LOUDNESS_LEAST, OF_THRUST);
    NAME_CONSTANTS(module, LESS_1, LOAD_EVIDENCE);
    module.def("whiten_blocks", &whiten_blocks);
    module.def("gather_evidence", &gather_evidence);
}

}  // namespace quadpi
