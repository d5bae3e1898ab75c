// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Rings of samples by topic, and what completes an IMU sample; see monitor/pairing.py.
#pragma once

#include <algorithm>
#include <limits>

#include "quadpi/estimator/imu_rate.hpp"
#include "quadpi/estimator/output.hpp"
#include "quadpi/signals/chain.hpp"

namespace quadpi {

enum Topic : std::int64_t { IMU, STATE, ROTOR_SPEEDS, WIND, TOPICS };
// What becomes of the oldest IMU sample.
enum Fate : std::int64_t { WAITS, EARLY, TAKEN };
// How a stretch begins: where the previous one ended; with a stamp more than MAX_JUMP_BACK_NS before the
// newest; with one that far before the stamp of the previous sample, as the IMU's clock was set back.
enum Begin : std::int64_t { CONTINUES, STEPS_BACK, SET_BACK };

// Where the last samples of a topic are in its ring; their stamps strictly increase.
struct Track {
    std::int64_t oldest;
    std::int64_t count;
    std::int64_t newest_ns;  // NO_STAMP before the first
};

// A state: the first signals of a sample.
struct StateValues {
    Vector3 velocity;
    Quaternion attitude;
    Vector3 rates;
};

constexpr std::size_t STATE_NUMBERS = sizeof(StateValues) / sizeof(double);
constexpr std::size_t WIDEST = std::max(STATE_NUMBERS, std::size_t{ROTORS_MAX});

// A sample of a topic: as many of the numbers as it has are used.
struct Entry {
    std::int64_t time_ns;
    std::array<double, WIDEST> values;
};

// What the pairing remembers beside the rings.
struct PairingState {
    std::array<Track, TOPICS> tracks;
    Meter meter;
    std::int64_t rotors;
    std::int64_t timeout_ns;
    // Of the IMU: the newest stamp since one stepped back, and that of the last sample. Of replays only.
    std::int64_t newest_ns;
    std::int64_t last_ns;
    std::int64_t rate_changes;  // `meter.changes` at the last take()
    bool noted;                 // whether the stamp at which a stretch begins has been noted
    // See pairing.PairingCounts.
    std::int64_t paired;
    std::int64_t early;
    std::int64_t dropped;
    std::int64_t disordered;
};

// Samples in the order in which they arrive.
struct ArrivingSamples {
    Records<const std::int64_t> kind;  // topic of each
    Records<const std::int64_t> row;   // its row in the arrays of that topic
    Records<const std::int64_t> imu_ns;
    Records<const Vector3> specific_force;
    Records<const std::int64_t> state_ns;
    Records<const StateValues> states;
    Records<const std::int64_t> rotor_ns;
    Records<const double> rotor_speeds;  // rows of n
    Records<const std::int64_t> wind_ns;
    Records<const Vector3> wind;
};

// Where and how the next stretch begins, and how many samples were taken before it.
struct StretchEnd {
    std::int64_t event;
    std::int64_t begin;
    std::int64_t count;
};

// The rings of all topics, one after the other, and their state.
class Pairing {
public:
    Pairing(PairingState& its_state, Records<Entry> its_rings)
        : state(its_state), rings(its_rings), capacity(static_cast<std::int64_t>(its_rings.size / TOPICS)) {}

    void add_imu(std::int64_t time_ns, const Vector3& specific_force) {
        follow_rate(time_ns);
        add(IMU, time_ns, specific_force.data(), 3);
    }

    // Add a state whose attitude has the sign nearest to the one before: q and −q are the same.
    void add_state(
        std::int64_t time_ns, const Vector3& velocity, const Quaternion& attitude, const Vector3& rates
    ) {
        const Track& track = state.tracks[STATE];
        double sign = 1.0;
        if (track.count > 0) {
            const Entry& newest = entry(STATE, track.oldest + track.count - 1);
            double projection = 0.0;
            for (int k = 0; k < 4; ++k) {
                projection += newest.values[3 + k] * attitude[k];
            }
            sign = projection < 0.0 ? -1.0 : 1.0;
        }
        if (Entry* added = make_room(STATE, time_ns)) {
            added->time_ns = time_ns;
            for (int k = 0; k < 3; ++k) {
                added->values[k] = velocity[k];
                added->values[7 + k] = rates[k];
            }
            for (int k = 0; k < 4; ++k) {
                added->values[3 + k] = sign * attitude[k];
            }
        }
    }

    // Add a sample of a topic, unless its stamp does not advance.
    void add(Topic topic, std::int64_t time_ns, const double* values, std::size_t count) {
        if (Entry* added = make_room(topic, time_ns)) {
            added->time_ns = time_ns;
            std::copy(values, values + count, added->values.begin());
        }
    }

    // Whether the rate of the IMU has changed since somebody was told.
    bool rate_has_changed() const { return state.meter.changes != state.rate_changes; }

    // Whether the oldest IMU sample waits no longer, or the rate of the IMU has changed.
    bool take_is_due() const { return rate_has_changed() || fate_of_oldest() != WAITS; }

    // Fill stamps and rows of the samples that are complete or given up, while there is room; returns their
    // number.
    std::int64_t take(Records<std::int64_t> taken_ns, double* taken) {
        Track& imu = state.tracks[IMU];
        const std::size_t channels = channels_of(state.rotors);
        std::size_t count = 0;
        for (Fate fate = fate_of_oldest(); fate != WAITS && count < taken_ns.size; fate = fate_of_oldest()) {
            if (fate == EARLY) {
                ++state.early;
            } else {
                const Entry& sample = entry(IMU, imu.oldest);
                Signals row;
                ++(complete(sample.time_ns, row) ? state.paired : state.dropped);
                std::copy_n(sample.values.begin(), 3, row.specific_force.begin());
                fill_row(row, state.rotors, taken + count * channels);
                taken_ns[count] = sample.time_ns;
                ++count;
            }
            drop_oldest(imu);
        }
        return static_cast<std::int64_t>(count);
    }

    // Take arrivals from `start` on until the IMU's stamps step back, or its rate changes.
    //
    // The stamp of the arrival at which the next stretch begins has been noted: the next call does not note
    // it again.
    StretchEnd take_stretch(
        const ArrivingSamples& arriving, std::int64_t start, Records<std::int64_t> taken_ns, double* taken
    ) {
        std::int64_t count = 0;
        const auto rotors = static_cast<std::size_t>(state.rotors), channels = channels_of(state.rotors);
        const auto events = static_cast<std::int64_t>(arriving.kind.size);
        for (std::int64_t event = start; event < events; ++event) {
            const std::int64_t kind = arriving.kind[event], row = arriving.row[event];
            if (kind == IMU) {
                const std::int64_t time_ns = arriving.imu_ns[row];
                if (!state.noted) {
                    const Begin begin = begin_at(time_ns);
                    const std::int64_t changes = state.meter.changes;
                    follow_rate(time_ns);
                    if (begin != CONTINUES || state.meter.changes != changes) {
                        state.noted = true;
                        return {event, begin, count};
                    }
                }
                state.noted = false;
                add(IMU, time_ns, arriving.specific_force[row].data(), 3);
            } else if (kind == STATE) {
                const StateValues& values = arriving.states[row];
                add_state(arriving.state_ns[row], values.velocity, values.attitude, values.rates);
            } else if (kind == ROTOR_SPEEDS) {
                const double* speeds = arriving.rotor_speeds.data + static_cast<std::size_t>(row) * rotors;
                add(ROTOR_SPEEDS, arriving.rotor_ns[row], speeds, rotors);
            } else {
                add(WIND, arriving.wind_ns[row], arriving.wind[row].data(), 3);
            }
            const auto filled = static_cast<std::size_t>(count);
            count += take(taken_ns.part(filled, taken_ns.size), taken + filled * channels);
        }
        return {events, CONTINUES, count};
    }

private:
    Entry& entry(Topic topic, std::int64_t place) const { return rings[topic * capacity + place % capacity]; }

    // How the stamp of an IMU sample continues those before it; it is noted.
    Begin begin_at(std::int64_t time_ns) {
        Begin begin = CONTINUES;
        if (state.newest_ns != NO_STAMP && time_ns < state.newest_ns - MAX_JUMP_BACK_NS) {
            begin = time_ns < state.last_ns - MAX_JUMP_BACK_NS ? SET_BACK : STEPS_BACK;
            state.newest_ns = time_ns;
        }
        state.newest_ns = std::max(state.newest_ns, time_ns);
        state.last_ns = time_ns;
        return begin;
    }

    // Take the stamp of an IMU sample; if it makes the rate known, samples that wait are forgotten.
    //
    // Samples are used from that one on. Whether those that wait were completed before depends on which topic
    // arrived first, and predictions must not.
    void follow_rate(std::int64_t time_ns) {
        const bool was_known = is_known(state.meter);
        follow(state.meter, time_ns);
        if (is_known(state.meter) && !was_known) {
            state.tracks[IMU].count = 0;
        }
    }

    // Room for a sample of that stamp, which is now the newest; none if it does not advance.
    Entry* make_room(Topic topic, std::int64_t time_ns) {
        Track& track = state.tracks[topic];
        if (time_ns <= track.newest_ns) {
            if (track.newest_ns - time_ns <= MAX_JUMP_BACK_NS) {
                ++state.disordered;
                return nullptr;
            }
            track.count = 0;
            if (topic == IMU && state.tracks[STATE].newest_ns > time_ns) {
                // The states kept are from before the jump back, and may be ahead of those that come.
                state.tracks[STATE].count = 0;
                state.tracks[STATE].newest_ns = NO_STAMP;
            }
        }
        track.newest_ns = time_ns;
        if (track.count == capacity) {
            drop_oldest(track);
        }
        Entry& room = entry(topic, track.oldest + track.count);
        ++track.count;
        return &room;
    }

    // Whether the oldest IMU sample waits, is too early for anything to complete it, or is to be taken.
    Fate fate_of_oldest() const {
        const Track &imu = state.tracks[IMU], &states = state.tracks[STATE],
                    &rotors = state.tracks[ROTOR_SPEEDS];
        if (imu.count == 0) {
            return WAITS;
        }
        const std::int64_t time_ns = entry(IMU, imu.oldest).time_ns;
        if (starts_after(STATE, time_ns) || starts_after(ROTOR_SPEEDS, time_ns)) {
            return EARLY;
        }
        if (states.newest_ns >= time_ns && rotors.newest_ns >= time_ns) {
            return TAKEN;
        }
        if (imu.count < capacity && imu.newest_ns - time_ns <= state.timeout_ns) {
            return WAITS;
        }
        return states.count == 0 || rotors.count == 0 ? EARLY : TAKEN;
    }

    // Fill state, rotor speeds and wind at a stamp; false if state or rotor speeds are not known there.
    bool complete(std::int64_t time_ns, Signals& row) {
        bool known = interpolate(STATE, time_ns, numbers_of(row), STATE_NUMBERS);
        scale_to_unit(row.attitude);
        const auto rotors = static_cast<std::size_t>(state.rotors);
        known &= interpolate(ROTOR_SPEEDS, time_ns, row.rotor_speeds.data(), rotors);
        row.wind = {};
        const std::int64_t held = hold(WIND, time_ns);
        if (held >= 0) {
            std::copy_n(entry(WIND, held).values.begin(), 3, row.wind.begin());
        }
        return known;
    }

    void drop_oldest(Track& track) {
        track.oldest = (track.oldest + 1) % capacity;
        --track.count;
    }

    // Whether every sample kept is later than the stamp: nothing can be interpolated there.
    bool starts_after(Topic topic, std::int64_t time_ns) const {
        const Track& track = state.tracks[topic];
        return track.count > 0 && entry(topic, track.oldest).time_ns > time_ns;
    }

    // Index of the last sample at or before the stamp, forgetting earlier ones; −1 if there is none.
    std::int64_t hold(Topic topic, std::int64_t time_ns) {
        Track& track = state.tracks[topic];
        while (track.count > 1 && entry(topic, track.oldest + 1).time_ns <= time_ns) {
            drop_oldest(track);
        }
        if (track.count == 0 || entry(topic, track.oldest).time_ns > time_ns) {
            return -1;
        }
        return track.oldest;
    }

    // Fill the values at a stamp, linearly between the samples around it; NaN and false without these.
    //
    // Between samples farther apart than MAX_GAP_NS nothing is known.
    bool interpolate(Topic topic, std::int64_t time_ns, double* values, std::size_t count) {
        // No sample at or before: the last place of the ring holds none of that stamp either.
        const std::int64_t before = (hold(topic, time_ns) + capacity) % capacity;
        const Entry &first = entry(topic, before), &second = entry(topic, before + 1);
        if (first.time_ns == time_ns) {
            std::copy_n(first.values.begin(), count, values);
            return true;
        }
        if (state.tracks[topic].count < 2 || second.time_ns - first.time_ns > MAX_GAP_NS) {
            std::fill_n(values, count, std::numeric_limits<double>::quiet_NaN());
            return false;
        }
        const double fraction = static_cast<double>(time_ns - first.time_ns) /
                                static_cast<double>(second.time_ns - first.time_ns);
        for (std::size_t k = 0; k < count; ++k) {
            values[k] = first.values[k] + fraction * (second.values[k] - first.values[k]);
        }
        return true;
    }

    PairingState& state;
    Records<Entry> rings;
    std::int64_t capacity;
};

}  // namespace quadpi
