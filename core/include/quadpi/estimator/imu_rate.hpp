// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// The sample rate of an IMU from the stamps of its samples in flight.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace quadpi {

// Number of steps that a rate is measured over: enough for stamps that are rounded to a millisecond.
constexpr int RATE_SPAN = 10;
// Largest difference of a span from the usual one, as a share of it. A span of ten that lost one sample is
// longer by a tenth: that and its jitter are no other rate.
constexpr double SPAN_TOLERANCE = 0.12;
// Time for which spans differ before the rate counts as another one.
constexpr std::int64_t NOTICED_NS = 200'000'000;
// A span that fits outweighs this many that do not: of another rate hardly any span fits, of a link that
// loses a seventh of the samples every other does.
constexpr std::int64_t FITS = 4;
// A step counts for at most this long: a gap says nothing about the rate.
constexpr std::int64_t STEP_MAX_NS = 20'000'000;

// For how long nearly all spans of ten steps have differed from the usual one, after one more sample.
inline std::int64_t off_for(
    std::int64_t off_ns, std::int64_t span_ns, double usual_ns, std::int64_t step_ns
) {
    step_ns = std::min(step_ns, STEP_MAX_NS);
    if (std::abs(static_cast<double>(span_ns) - usual_ns) > SPAN_TOLERANCE * usual_ns) {
        return off_ns + step_ns;
    }
    return std::max<std::int64_t>(0, off_ns - FITS * step_ns);
}

}  // namespace quadpi
