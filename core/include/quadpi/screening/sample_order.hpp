// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Which samples of a topic came late, and where its clock begins again; see screening/sample_order.py.
#pragma once

#include <algorithm>
#include <cstdlib>

#include "quadpi/limits.hpp"
#include "quadpi/records.hpp"

namespace quadpi {

// What a sample is in its run of the clock.
constexpr std::int8_t RISES = 0, LATE = 1, ALONE = 2;

// Whether two stamps before the newest lie in one hole between the rising ones.
inline bool one_hole(
    Records<const std::int64_t> rising, std::int64_t first, std::int64_t second, double hole_ns
) {
    const std::int64_t* high = std::lower_bound(rising.begin(), rising.end() - 1, first);
    if (high == rising.begin()) {
        return false;
    }
    const std::int64_t before = *(high - 1);
    return before < first && first < second && second < *high &&
           static_cast<double>(*high - before) >= hole_ns;
}

// Fill the kind and the run of each sample; `rising` has room for the stamps of a run.
inline void scan_order(
    Records<const std::int64_t> time_ns,
    double hole_ns,
    std::int64_t* rising,
    Records<std::int8_t> kinds,
    Records<std::int64_t> run_of
) {
    std::size_t held = 0, last = 0;
    std::int64_t run = 0;
    for (std::size_t i = 0; i < time_ns.size; ++i) {
        const bool is_last = i + 1 == time_ns.size;
        const std::int64_t stamp = time_ns[i], following = time_ns[is_last ? i : i + 1];
        run_of[i] = run;
        if (held > 0) {
            const std::int64_t newest = rising[held - 1], step = stamp - newest;
            const bool alone = is_last || std::abs(following - stamp) >= std::abs(following - newest);
            if (alone && step > (is_last ? FLIGHT_MAX_NS : MAX_GAP_NS) && following <= stamp) {
                kinds[i] = ALONE;
                continue;
            }
            const bool falls = step < -MAX_GAP_NS && following > stamp && !alone;
            if (step > FLIGHT_MAX_NS || (falls && (step < -MAX_JUMP_BACK_NS ||
                                                   !one_hole({rising, held}, stamp, following, hole_ns)))) {
                if (held == 1) {
                    kinds[last] = ALONE;
                } else {
                    ++run;
                }
                held = 0;
                run_of[i] = run;
            } else if (step <= 0) {
                kinds[i] = LATE;
                continue;
            }
        }
        rising[held++] = stamp;
        last = i;
    }
}

}  // namespace quadpi
