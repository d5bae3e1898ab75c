// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// The sample rate of an IMU from the stamps of its samples in flight.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "quadpi/limits.hpp"

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
// A rate is measured over this time.
constexpr std::int64_t MEASURED_NS = 1'000'000'000;
// Stamps of a second, at the fastest rate that a node takes and more.
constexpr int METER_ROOM = 8192;

// What is remembered of the stamps.
struct Meter {
    double span_ns;        // usual time of ten steps; 0 while it is not known
    bool lost;             // whether the rate is being measured again, after a pause or a change
    std::int64_t changes;  // how often `span_ns` or `lost` has changed
    std::int64_t count;    // stamps since the measurement began
    std::int64_t newest_ns;
    std::int64_t jumped_ns;  // stamp of the previous sample, where that was far from all before it
    std::int64_t off_ns;     // for how long nearly all spans have differed from the usual one
    std::array<std::int64_t, METER_ROOM> stamps;  // a ring of those since the measurement began
};

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

// Whether the rate is known, or was before it changed: false in the first second.
inline bool is_known(const Meter& meter) { return meter.span_ns > 0.0 || meter.lost; }

inline void append(Meter& meter, std::int64_t time_ns) {
    meter.stamps[meter.count % METER_ROOM] = time_ns;
    ++meter.count;
    meter.newest_ns = time_ns;
}

inline void begin(Meter& meter, std::int64_t time_ns) {
    meter.count = 0;
    meter.off_ns = 0;
    meter.jumped_ns = NO_STAMP;
    meter.span_ns = 0.0;
    ++meter.changes;
    append(meter, time_ns);
}

// The median over spans of ten steps among the first stamps, as signals/chain.py finds it.
inline double usual_span(const Meter& meter) {
    const std::int64_t span = std::min<std::int64_t>(RATE_SPAN, meter.count - 1);
    const std::int64_t spans = meter.count - span, half = spans / 2;
    std::array<double, METER_ROOM> sorted;
    for (std::int64_t index = 0; index < spans; ++index) {
        sorted[index] = static_cast<double>(meter.stamps[index + span] - meter.stamps[index]);
    }
    std::nth_element(sorted.begin(), sorted.begin() + half, sorted.begin() + spans);
    double usual = sorted[half];
    if (spans % 2 == 0) {
        usual = (*std::max_element(sorted.begin(), sorted.begin() + half) + usual) / 2.0;
    }
    return usual * RATE_SPAN / static_cast<double>(span);
}

// Take the stamp of one IMU sample.
inline void follow(Meter& meter, std::int64_t time_ns) {
    if (meter.count == 0) {
        begin(meter, time_ns);
        return;
    }
    const std::int64_t since_ns = time_ns - meter.newest_ns;
    if (since_ns > MAX_GAP_NS || since_ns < -MAX_JUMP_BACK_NS) {
        // One stamp alone may be broken; two that agree are a pause or another clock.
        const std::int64_t after_jump_ns = time_ns - meter.jumped_ns;
        if (0 < after_jump_ns && after_jump_ns <= MAX_GAP_NS) {
            meter.lost = since_ns > 0 && (meter.span_ns > 0.0 || meter.lost);
            begin(meter, meter.jumped_ns);
            append(meter, time_ns);
        } else {
            meter.jumped_ns = time_ns;
        }
        return;
    }
    meter.jumped_ns = NO_STAMP;
    if (since_ns <= 0) {
        return;
    }
    append(meter, time_ns);
    if (meter.span_ns == 0.0) {
        if (time_ns - meter.stamps[0] >= MEASURED_NS || meter.count == METER_ROOM) {
            meter.span_ns = usual_span(meter);
            meter.lost = false;
            ++meter.changes;
        }
        return;
    }
    // Python's remainder: the measurement may have begun less than a span ago.
    const std::int64_t place = (meter.count - 1 - RATE_SPAN + METER_ROOM) % METER_ROOM;
    meter.off_ns = off_for(meter.off_ns, time_ns - meter.stamps[place], meter.span_ns, since_ns);
    if (meter.off_ns > NOTICED_NS) {
        meter.lost = true;
        begin(meter, time_ns);
    }
}

}  // namespace quadpi
