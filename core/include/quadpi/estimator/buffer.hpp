// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What each sample does to the filter's memory of the last half second.
//
// Motion capture is late: a measurement is fused at the instant that it was taken, and the estimates since
// then are computed again. So that the order of arrival hardly matters, and replay equals live, a measurement
// stamped s is held until the first IMU sample that is stamped s + HOLD_NS or later; one that arrives after
// that is fused at the next IMU sample.
#pragma once

#include <algorithm>

#include "quadpi/estimator/corrections.hpp"
#include "quadpi/estimator/imu_rate.hpp"
#include "quadpi/limits.hpp"
#include "quadpi/records.hpp"

namespace quadpi {

constexpr std::int64_t HOLD_NS = 10'000'000;
// How far back estimates are kept: the latest motion capture that can be fused.
constexpr std::int64_t BUFFER_NS = 500'000'000;
// Rejections that persist for this long, and agree among themselves, are taken for the truth.
constexpr std::int64_t PERSISTENCE_NS = 400'000'000;
constexpr std::int64_t PERSISTENCE_COUNT = 5;
// A sensor with noise never repeats a value this often; one that does, after this many changes, is frozen.
constexpr std::int64_t REPEATS_MAX = 12;

// Without a correction for this long the state is DEGRADED, then LOST.
constexpr std::int64_t DEGRADED_NS = 250'000'000;
constexpr std::int64_t LOST_NS = 2'000'000'000;
constexpr std::int64_t DEGRADED_REJECTIONS = 3;
// Standard deviation beyond which a velocity is of no use as an input of a model.
constexpr double VELOCITY_STD_MAX_M_S = 2.0;
// Standard deviations beyond which the state is DEGRADED: it has not settled after its start, or after a jump
// of motion capture that was accepted. Up to this velocity predictions differ from those of a settled state
// by no more than half of the half width of their intervals; this specific force is 1 % of the weight.
constexpr double SETTLED_VELOCITY_STD_M_S = 0.05;
constexpr double SETTLED_BIAS_STD_M_S2 = 0.1;
// The same of a state by measurements that state a noise: theirs, up to this.
constexpr double SETTLED_COARSE_STD_M_S = 0.5;
// Time [s] over which positions tell the velocity where no velocities come: it is known to their error in it.
constexpr double SETTLED_BY_POSITIONS_S = 1.0;
// Steps of a slow source that are waited for, one lost or several, before the state is DEGRADED, and LOST.
constexpr std::int64_t SLOW_DEGRADED = 3, SLOW_LOST = 5;

// Place of the source of a measurement: poses, then velocities.
inline int source_of(const Measurement& measurement) { return measurement.kind == POSE ? 0 : 1; }

// Whether a measurement can be one.
inline bool usable(const Measurement& measurement) {
    const auto [vector, attitude] = measurement.deviation;
    if (!std::isfinite(vector) || !std::isfinite(attitude) || !(measured(vector) || measured(attitude))) {
        return false;
    }
    if (measurement.kind != POSE) {
        return measured(vector) && usable_velocity(measurement.vector);
    }
    return usable_pose(
        measured(vector) ? measurement.vector : Vector3{},
        measured(attitude) ? measurement.attitude : Quaternion{1.0, 0.0, 0.0, 0.0}
    );
}

// The filter and its ring of an estimate at the stamp of each IMU sample of the last half second.
class Buffer {
public:
    Buffer(Filter& filter, Records<Estimate> ring)
        : memory(filter), ring(ring), size(static_cast<std::int64_t>(ring.size)) {}

    // Move the newest estimate to the stamp of an IMU sample; fuse_due() is next.
    //
    // A sample that is not USED changes only what tells a jump of the stamps or another rate.
    Outcome predict(const ImuSample& sample) {
        if (!usable_imu(sample.rates, sample.specific_force)) {
            return UNUSABLE;
        }
        const Outcome outcome = stamp_outcome(sample.time_ns);
        if (outcome != USED) {
            return outcome;
        }
        const std::int64_t before = memory.newest, following = after(before);
        static_cast<ImuSample&>(ring[following]) = sample;
        load_latest(before);
        advance(memory.prior, before, sample.time_ns);
        ring[following].take_state(memory.prior);
        memory.newest = following;
        memory.filled = std::min(memory.filled + 1, size);
        memory.status = status();
        ++memory.counts[0][outcome];
        return outcome;
    }

    // Move the initial estimate on over the IMU samples since then, which have been counted before.
    void catch_up(Records<ImuSample> samples) {
        const std::int64_t counted = memory.counts[0][USED];
        for (const ImuSample& sample : samples) {
            predict(sample);
        }
        memory.counts[0][USED] = counted;
        memory.accepted_ns = newest().time_ns;
        memory.status = status();
    }

    // Take one measurement; it is fused when its time has come.
    //
    // Gives COLLECTED, or why it is refused, which is counted.
    Outcome hold(const Measurement& measurement) {
        const int place = source_of(measurement);
        Source& source = memory.sources[place];
        const std::int64_t time_ns = measurement.time_ns;
        Outcome outcome = COLLECTED;
        if (!usable(measurement)) {
            outcome = UNUSABLE;
        } else if (time_ns > newest().time_ns + MAX_GAP_NS || memory.held_count == HELD) {
            outcome = TOO_EARLY;
        } else if (source.arrived_ns - MAX_JUMP_BACK_NS <= time_ns && time_ns <= source.arrived_ns) {
            outcome = STAMP_NOT_ADVANCING;
        }
        if (outcome != COLLECTED) {
            ++memory.counts[1 + place][outcome];
            return outcome;
        }
        source.step_before_ns = source.step_ns;
        source.step_ns =
            source.arrived_ns == NO_STAMP ? 0 : std::max<std::int64_t>(time_ns - source.arrived_ns, 0);
        source.arrived_ns = time_ns;
        // In the order of stamps: an odometry's two parts, and sources that overtake each other.
        std::int64_t at = (memory.held_first + memory.held_count) % HELD;
        for (std::int64_t moved = 0; moved < memory.held_count; ++moved) {
            const std::int64_t previous = (at + HELD - 1) % HELD;
            if (memory.held[previous].time_ns <= time_ns) {
                break;
            }
            memory.held[at] = memory.held[previous];
            at = previous;
        }
        memory.held[at] = measurement;
        ++memory.held_count;
        return outcome;
    }

    // Fuse the measurements whose time has come, after predict().
    //
    // journal: filled with each correction as it was applied, while there is room.
    void fuse_due(Records<Correction> journal) {
        const std::int64_t now_ns = newest().time_ns;
        while (memory.held_count > 0 && memory.held[memory.held_first].time_ns + HOLD_NS <= now_ns) {
            const Measurement measurement = memory.held[memory.held_first];
            memory.held_first = (memory.held_first + 1) % HELD;
            --memory.held_count;
            const Outcome outcome = fuse_one(measurement);
            ++memory.counts[1 + source_of(measurement)][outcome];
            if (outcome == USED && memory.journalled < static_cast<std::int64_t>(journal.size)) {
                journal[memory.journalled] = memory.correction;
                ++memory.journalled;
            }
        }
        memory.status = status();
    }

    // The estimate at the stamp of the newest IMU sample.
    const Estimate& newest() const { return ring[memory.newest]; }

    // How far the newest estimate can be used.
    Status status() const {
        const ErrorMatrix& covariance = newest().covariance;
        const std::int64_t since = newest().time_ns - memory.accepted_ns;
        const double velocity = largest_variance(covariance, VELOCITY);
        const double bias = largest_variance(covariance, ACCELEROMETER_BIAS);
        const std::int64_t usual = usual_step_ns();
        if (since > std::max(LOST_NS, SLOW_LOST * usual) ||
            velocity > VELOCITY_STD_MAX_M_S * VELOCITY_STD_MAX_M_S) {
            return LOST;
        }
        const std::int64_t rejections = std::max(memory.sources[0].refusals, memory.sources[1].refusals);
        const double settled_velocity = settled_velocity_std();
        const bool settled = velocity <= settled_velocity * settled_velocity &&
                             bias <= SETTLED_BIAS_STD_M_S2 * SETTLED_BIAS_STD_M_S2;
        const bool waits = since > std::max(DEGRADED_NS, SLOW_DEGRADED * usual);
        return waits || rejections >= DEGRADED_REJECTIONS || !settled ? DEGRADED : OK;
    }

private:
    Filter& memory;
    Records<Estimate> ring;
    std::int64_t size;

    // Time between measurements of the source that sends most; 0 before it is known.
    std::int64_t usual_step_ns() const {
        const std::int64_t poses = memory.sources[0].usual_step_ns();
        const std::int64_t velocities = memory.sources[1].usual_step_ns();
        return poses == 0 || velocities == 0 ? std::max(poses, velocities) : std::min(poses, velocities);
    }

    // Standard deviation of the velocity of a settled state: no more than that of one coarse measurement, and
    // without velocities no more than positions tell of it in a while.
    double settled_velocity_std() const {
        const Source& velocities = memory.sources[1];
        const double coarse = velocities.arrived_ns != NO_STAMP
                                  ? velocities.last.deviation[0]
                                  : memory.sources[0].last.deviation[0] / SETTLED_BY_POSITIONS_S;
        return std::min(std::max(SETTLED_VELOCITY_STD_M_S, coarse), SETTLED_COARSE_STD_M_S);
    }

    std::int64_t after(std::int64_t place) const { return (place + 1) % size; }

    // USED, or why an IMU sample of that stamp cannot be.
    Outcome stamp_outcome(std::int64_t time_ns) {
        const std::int64_t since = time_ns - newest().time_ns;
        if (since > MAX_GAP_NS || since < -MAX_JUMP_BACK_NS) {
            // One stamp alone may be broken; two that agree are a pause or another clock.
            const std::int64_t since_jump = time_ns - memory.jumped_ns;
            if (0 < since_jump && since_jump <= MAX_GAP_NS) {
                return RESET;
            }
            memory.jumped_ns = time_ns;
            return STAMP_JUMPED;
        }
        memory.jumped_ns = NO_STAMP;
        if (since <= 0) {
            return STAMP_NOT_ADVANCING;
        }
        if (memory.rate_span_ns > 0 && memory.filled >= RATE_SPAN) {
            const std::int64_t first = (memory.newest + 1 - RATE_SPAN + size) % size;
            const std::int64_t span_ns = time_ns - ring[first].time_ns;
            memory.rate_off_ns =
                off_for(memory.rate_off_ns, span_ns, static_cast<double>(memory.rate_span_ns), since);
            if (memory.rate_off_ns > NOTICED_NS) {
                return RESET;
            }
        }
        return USED;
    }

    // Fuse one measurement at the instant that it was taken.
    //
    // Instants before the last correction, or after the newest IMU sample, are not corrected: the measurement
    // is compared with what the motion of the nearest estimate makes of them.
    Outcome fuse_one(const Measurement& measurement) {
        const std::int64_t newest_ns = newest().time_ns;
        const std::int64_t instant = taken_ns(newest(), measurement);
        if (instant < newest_ns - BUFFER_NS) {
            return TOO_LATE;
        }
        const Estimate& oldest = ring[(memory.newest - memory.filled + 1 + size) % size];
        const std::int64_t instant_ns =
            std::min(std::max({instant, memory.corrected.time_ns, oldest.time_ns}), newest_ns);
        const std::int64_t before = recall(instant_ns);
        if (frozen(measurement)) {
            return FROZEN;
        }
        memory.correction.time_ns = instant_ns;
        memory.correction.measurement = measurement;
        if (!corrected(memory.correction)) {
            return REJECTED;
        }
        memory.sources[source_of(measurement)].refusals = 0;
        memory.accepted_ns = newest_ns;
        memory.corrected = memory.trial;
        recompute(before);
        return USED;
    }

    // Set `memory.prior` to the estimate at an instant; the place of the one at or before it.
    std::int64_t recall(std::int64_t instant_ns) {
        std::int64_t before = memory.newest;
        while (ring[before].time_ns > instant_ns) {
            before = (before + size - 1) % size;
        }
        load_latest(before);
        advance(memory.prior, before, instant_ns);
        interpolate_sample(memory.prior, ring[before], ring[after(before)]);
        return before;
    }

    // Correct `memory.prior` into `memory.trial`; false if the measurement is rejected.
    //
    // One beyond its gate is accepted once rejections persist, by an estimate that is widened for it first.
    bool corrected(Correction& correction) {
        const Measurement& measurement = correction.measurement;
        correction.widening = {};
        memory.trial = memory.prior;
        correction.nis = fuse(memory.trial, memory.noise, measurement, memory.scalars);
        if (correction.nis <= gate_of(measurement)) {
            return true;
        }
        if (!rejections_persist(measurement)) {
            return false;
        }
        correction.widening = widening_for(memory.prior, noise_of(memory.noise, measurement), measurement);
        memory.trial = memory.prior;
        widen(memory.trial, correction.widening);
        correction.nis = fuse(memory.trial, memory.noise, measurement, memory.scalars);
        return true;
    }

    // Compute the estimates after `memory.trial` again, which lies at or after the one at `before`.
    void recompute(std::int64_t before) {
        Estimate& estimate = memory.trial;
        if (ring[before].time_ns == estimate.time_ns) {
            ring[before].take_state(estimate);
        }
        while (before != memory.newest) {
            const std::int64_t following = after(before);
            advance(estimate, before, ring[following].time_ns);
            ring[following].take_state(estimate);
            before = following;
        }
    }

    // Set `memory.prior` to the last estimate before the IMU sample that follows the one at `before`.
    //
    // That is the last correction, if it is that late.
    void load_latest(std::int64_t before) {
        memory.prior = memory.corrected.time_ns >= ring[before].time_ns ? memory.corrected : ring[before];
    }

    // Propagate an estimate between the IMU sample at `before` and the one that follows.
    void advance(Estimate& estimate, std::int64_t before, std::int64_t to_ns) {
        if (to_ns > estimate.time_ns) {
            propagate_between(
                estimate, memory.noise, ring[before], ring[after(before)], to_ns, memory.transition
            );
        }
    }

    // Whether a measurement only repeats the previous one although the vehicle moves, or for too long.
    bool frozen(const Measurement& measurement) {
        Source& source = memory.sources[source_of(measurement)];
        if (source.last.vector != measurement.vector || source.last.attitude != measurement.attitude) {
            source.last = measurement;
            source.repeats = 0;
            source.changes = std::min(source.changes + 1, REPEATS_MAX);
            return false;
        }
        ++source.repeats;
        if (source.repeats >= REPEATS_MAX && source.changes >= REPEATS_MAX) {
            return true;
        }
        const double elapsed = 1e-9 * static_cast<double>(measurement.time_ns - source.last.time_ns);
        const Noise own = noise_of(memory.noise, measurement);
        return motion_shows(memory.prior, own, measurement.kind, elapsed);
    }

    // Note a rejection; whether rejections that agree among themselves have lasted long enough.
    bool rejections_persist(const Measurement& measurement) {
        Source& source = memory.sources[source_of(measurement)];
        const bool agrees =
            source.refusals > 0 &&
            same_motion(
                source.refused,
                measurement,
                memory.prior,
                noise_of(memory.noise, measurement),
                std::max(AGREE_LATEST_S, 1e-9 * static_cast<double>(SLOW_DEGRADED * source.usual_step_ns()))
            );
        if (!agrees) {
            source.refusals = 0;
            source.refused_since_ns = measurement.time_ns;
        }
        ++source.refusals;
        source.refused = measurement;
        const bool lasted = measurement.time_ns - source.refused_since_ns >= PERSISTENCE_NS;
        return lasted && source.refusals >= PERSISTENCE_COUNT;
    }

    // The largest of three variances.
    static double largest_variance(const ErrorMatrix& covariance, int first) {
        return std::max(
            {covariance[first][first], covariance[first + 1][first + 1], covariance[first + 2][first + 2]}
        );
    }
};

}  // namespace quadpi
