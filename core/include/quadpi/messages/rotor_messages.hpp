// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Reports of speed controllers (ESCs) as rotor speeds: which are of the vehicle's rotors, and which are new.
//
// Arrays of reports have the lengths that check() asks for.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "quadpi/records.hpp"
#include "quadpi/signals/chain.hpp"

namespace quadpi {

using EscNumbers = std::array<std::int64_t, ROTORS_MAX>;

// PX4's `actuator_function` of the first motor and of the last.
constexpr std::int64_t FIRST_MOTOR = 101, LAST_MOTOR = 112;
// PX4 takes an ESC that has not reported for as long for gone (MavlinkStreamESCStatus) [ns].
constexpr std::int64_t ESC_SILENT_NS = 100'000'000;

// Whether reports form a sample, or the reason why not; quadpi_core.findings has the words.
enum EscVerdict : std::uint8_t {
    SAMPLE,
    NONE_ANNOUNCED,
    TOO_FEW,
    MOTOR_MISSING,
    MOTOR_TWICE,
    OFFLINE,
    NEVER_REPORTED,
    SILENT,
    REPEATED,
    MORE_ROTORS,
};

// Reports of N messages, each of as many values as the vehicle has rotors, in its order.
struct EscReports {
    Records<double> rpm;
    Records<std::int64_t> marks;  // change with every report of the ESC
    Records<std::uint8_t> verdict;

    bool of(std::size_t messages, std::size_t rotors) const {
        return rpm.size == messages * rotors && marks.size == messages * rotors && verdict.size == messages;
    }
};

// All reports in N messages, one after the other.
struct EscArray {
    Records<const double> rpm;
    Records<const std::int64_t> marks;
};

// Whether as many reports are there as messages count.
inline bool check(Records<const std::int64_t> counts, const EscArray& array) {
    std::size_t left = array.rpm.size;
    for (const std::int64_t count : counts) {
        if (count < 0 || static_cast<std::uint64_t>(count) > left) {
            return false;
        }
        left -= static_cast<std::size_t>(count);
    }
    return array.marks.size == array.rpm.size;
}

// Take the reports of the wanted ESCs, not negative, where the place in the array is the number of the ESC.
inline void take_numbered(
    Records<const std::int64_t> counts,
    const EscArray& array,
    Records<const std::int64_t> wanted,
    EscReports& reports
) {
    std::int64_t last = wanted[0];
    for (const std::int64_t number : wanted) {
        last = number > last ? number : last;
    }
    std::size_t start = 0;
    for (std::size_t n = 0; n < counts.size; ++n) {
        const auto stop = start + static_cast<std::size_t>(counts[n]);
        std::size_t turning = 0;
        for (std::size_t place = start; place < stop; ++place) {
            turning += array.rpm[place] != 0.0;
        }
        if (counts[n] == 0) {
            reports.verdict[n] = NONE_ANNOUNCED;
        } else if (counts[n] <= last) {
            reports.verdict[n] = TOO_FEW;
        } else if (turning > wanted.size) {
            reports.verdict[n] = MORE_ROTORS;
        } else {
            for (std::size_t rotor = 0; rotor < wanted.size; ++rotor) {
                const std::size_t place = start + static_cast<std::size_t>(wanted[rotor]);
                reports.rpm[n * wanted.size + rotor] = array.rpm[place];
                reports.marks[n * wanted.size + rotor] = array.marks[place];
            }
        }
        start = stop;
    }
}

// Take the reports of the wanted motors, where each report names its motor.
//
// `functions` says what each report is of, as many in every message; `online` has bits by place in the array;
// a mark of 0 is of an ESC that has never reported.
inline void take_of_motors(
    Records<const std::int64_t> functions,
    const EscArray& array,
    Records<const std::int64_t> online,
    Records<const std::int64_t> wanted,
    EscReports& reports
) {
    const std::size_t each = online.size > 0 ? functions.size / online.size : 0;
    for (std::size_t n = 0; n < online.size; ++n) {
        const std::size_t start = n * each;
        std::size_t turning = 0;
        for (std::size_t place = start; place < start + each; ++place) {
            turning +=
                FIRST_MOTOR <= functions[place] && functions[place] <= LAST_MOTOR && array.rpm[place] != 0.0;
        }
        std::uint8_t& verdict = reports.verdict[n];
        for (std::size_t rotor = 0; rotor < wanted.size; ++rotor) {
            std::size_t found = each;
            for (std::size_t place = 0; place < each; ++place) {
                if (functions[start + place] != wanted[rotor]) {
                    continue;
                }
                if (found < each) {
                    verdict = MOTOR_TWICE;
                }
                found = place;
            }
            if (found == each) {
                verdict = MOTOR_MISSING;
            } else if (found >= 64 || (online[n] >> found & 1) == 0) {
                verdict = OFFLINE;
            } else if (array.marks[start + found] == 0) {
                verdict = NEVER_REPORTED;
            } else {
                reports.rpm[n * wanted.size + rotor] = array.rpm[start + found];
                reports.marks[n * wanted.size + rotor] = array.marks[start + found];
            }
        }
        if (turning > wanted.size && verdict != MOTOR_TWICE) {
            verdict = MORE_ROTORS;
        }
    }
}

// What was last heard of the ESCs.
struct EscMemory {
    EscNumbers latest;    // the marks of the last row; -1 before the first
    EscNumbers heard_ns;  // when they changed
};

// The verdict on a sample that may hold nothing new, or in which an ESC may have been silent for too long.
inline EscVerdict judge_news(std::int64_t time_ns, Records<const std::int64_t> marks, EscMemory& memory) {
    bool news = false, silent = false;
    for (std::size_t rotor = 0; rotor < marks.size; ++rotor) {
        if (marks[rotor] != memory.latest[rotor]) {
            memory.latest[rotor] = marks[rotor];
            memory.heard_ns[rotor] = time_ns;
            news = true;
        } else if (time_ns - memory.heard_ns[rotor] > ESC_SILENT_NS) {
            silent = true;
        }
    }
    return !news ? REPEATED : silent ? SILENT : SAMPLE;
}

}  // namespace quadpi
