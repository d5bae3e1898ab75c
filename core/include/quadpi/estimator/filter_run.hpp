// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// The Kalman filter over samples: one as it comes live, or whole streams in the order of arrival.
#pragma once

#include "quadpi/estimator/buffer.hpp"
#include "quadpi/estimator/output.hpp"

namespace quadpi {

// The estimate at the stamp of one IMU sample, without the correlations of its errors.
struct EstimatedSample : NominalState {
    std::int64_t time_ns;
    ErrorVector variance;
};

// The same of the filter.
struct FilteredSample : EstimatedSample {
    std::int64_t status;
    std::int64_t sample;  // index of the IMU sample
};

// How far run() has come.
struct Progress {
    std::int64_t samples;       // IMU samples taken
    std::int64_t measurements;  // measurements taken
    std::int64_t estimates;     // estimates written
};

// The samples of a recording in the order of their arrival.
struct Arrivals {
    Records<ImuSample> samples;
    Records<Measurement> measurements;
    Records<std::int64_t> after;  // how many IMU samples had arrived before each measurement
};

// What run() writes.
struct Trace {
    Progress& progress;
    Records<std::int64_t> outcomes;  // what became of each IMU sample
    Records<FilteredSample> rows;
    Records<FusedSample> fused;   // empty where they are not needed
    Records<Correction> journal;  // empty where they are not needed
};

// One IMU sample as it comes live: propagate, fuse the measurements whose time has come, give the output.
//
// journal: see Buffer::fuse_due.
// fused: filled if the sample is USED; only such samples are counted here.
inline Outcome step(
    Buffer& buffer,
    const Filter& filter,
    const ImuSample& sample,
    Records<Correction> journal,
    FusedSample& fused
) {
    const Outcome outcome = buffer.predict(sample);
    if (outcome == USED) {
        buffer.fuse_due(journal);
        fill_fused(buffer.newest(), filter.noise.rates, fused);
    }
    return outcome;
}

// Append the newest estimate, which is that after the IMU sample of this index.
inline void record(const Buffer& buffer, const Filter& filter, Trace& trace, std::int64_t sample) {
    const Estimate& estimate = buffer.newest();
    FilteredSample& row = trace.rows[trace.progress.estimates];
    static_cast<NominalState&>(row) = estimate;
    row.time_ns = estimate.time_ns;
    row.status = filter.status;
    row.sample = sample;
    for (int index = 0; index < ERROR_STATES; ++index) {
        row.variance[index] = estimate.covariance[index][index];
    }
    if (trace.fused.size > 0) {
        fill_fused(estimate, filter.noise.rates, trace.fused[trace.progress.estimates]);
    }
    ++trace.progress.estimates;
}

// Take samples as they arrived, from `trace.progress` on.
//
// Stops at the end of the IMU samples, or before one that asks for a RESET.
inline void run(Filter& filter, Records<Estimate> ring, const Arrivals& arrivals, Trace& trace) {
    Buffer buffer(filter, ring);
    Progress& progress = trace.progress;
    while (progress.samples < static_cast<std::int64_t>(arrivals.samples.size)) {
        const std::int64_t index = progress.samples, following = progress.measurements;
        if (following < static_cast<std::int64_t>(arrivals.measurements.size) &&
            arrivals.after[following] <= index) {
            buffer.hold(arrivals.measurements[following]);
            ++progress.measurements;
            continue;
        }
        const Outcome outcome = buffer.predict(arrivals.samples[index]);
        if (outcome == RESET) {
            return;
        }
        trace.outcomes[index] = outcome;
        ++progress.samples;
        if (outcome == USED) {
            buffer.fuse_due(trace.journal);
            record(buffer, filter, trace, index);
        } else {
            ++filter.counts[0][outcome];
        }
    }
}

}  // namespace quadpi
