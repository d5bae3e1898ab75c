// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Why a sample cannot be judged or trusted: one bit per fault, O(1) per sample; see monitor/preparation.py.
#pragma once

#include <algorithm>
#include <limits>

#include "quadpi/limits.hpp"
#include "quadpi/signals/chain.hpp"

namespace quadpi {

constexpr double INF = std::numeric_limits<double>::infinity();

// One bit per rotor from each of the ROTOR_ ones on, for four rotors; see Faults.
enum Fault : std::int64_t {
    NOT_FINITE = 1 << 0,
    NOT_PLAUSIBLE = 1 << 1,
    STAMP_REPEATED = 1 << 2,
    STAMP_BACKWARD = 1 << 3,
    GAP = 1 << 4,
    STATE_MISSING = 1 << 5,
    ROTORS_MISSING = 1 << 6,
    GYRO_FROZEN = 1 << 7,
    ACCELEROMETER_FROZEN = 1 << 8,
    ROTOR_FROZEN = 1 << 9,
    ROTOR_HALF = 1 << 13,
    ROTOR_JUMPS = 1 << 17,
    ROTOR_DIFFERS = 1 << 21,
    RATE_DIFFERS = 1 << 25,  // the IMU's rate is not the one given
    RATE_UNKNOWN = 1 << 26,  // it is not known (any more)
    RATE_LOW = 1 << 27,      // it is too low for the model's low-pass
    // A rotor reads 0 while others turn. Whether it has stopped or its telemetry fails, `rotor_thrust`
    // decides.
    ROTOR_ZERO = 1 << 28,
};
// Rotors whose bits have a place in a word of faults, and the bits of all of them.
constexpr int ROTORS_OF_WORD = 4;
constexpr std::int64_t every_rotor(Fault fault) { return std::int64_t{fault} * ((1 << ROTORS_OF_WORD) - 1); }
constexpr std::int64_t ROTOR_FAULTS = (RATE_DIFFERS - ROTOR_FROZEN) | every_rotor(ROTOR_ZERO);
// Faults that mean nothing on the ground, where motors start one after the other and sensors may rest.
constexpr std::int64_t IN_FLIGHT_ONLY = (RATE_DIFFERS - GYRO_FROZEN) | ROTOR_FAULTS;

// Bits of the faults of a sample: one word with those of rotors 1 to 4, and one for each four rotors more,
// which have their bits at the same places.
struct Faults {
    std::array<std::int64_t, ROTORS_MAX / ROTORS_OF_WORD> words;

    static Faults of(std::int64_t faults) { return {{faults}}; }

    void add(std::int64_t faults) { words[0] |= faults; }
    void add(const Faults& faults) {
        for (std::size_t word = 0; word < words.size(); ++word) {
            words[word] |= faults.words[word];
        }
    }
    void add(Fault fault, int rotor) {
        words[rotor / ROTORS_OF_WORD] |= std::int64_t{fault} << rotor % ROTORS_OF_WORD;
    }
    void keep(std::int64_t faults) {
        for (std::int64_t& word : words) {
            word &= faults;
        }
    }
    bool any(std::int64_t faults = -1) const {
        return std::any_of(words.begin(), words.end(), [=](std::int64_t word) {
            return (word & faults) != 0;
        });
    }
    bool any_beyond(const Faults& others) const {
        bool found = false;
        for (std::size_t word = 0; word < words.size(); ++word) {
            found |= (words[word] & ~others.words[word]) != 0;
        }
        return found;
    }
    bool has(Fault fault, int rotor) const {
        return (words[rotor / ROTORS_OF_WORD] & std::int64_t{fault} << rotor % ROTORS_OF_WORD) != 0;
    }
};

// The estimator moves its biases at every correction, so the readings of a frozen sensor less its bias still
// creep, by at most this much per sample [rad/s, m/s²].
constexpr double CREEP_RAD_S = 0.01, CREEP_M_S2 = 0.05;
// Speed controllers may repeat a reading until the next one comes, for at most so long [s].
constexpr double STUCK_S = 0.5;
// Readings of a rotor that differ by less are the same [rad/s].
constexpr double STUCK_RAD_S = 1e-3;
// Resolution, as a share of the speed, in which a rotor that turns changes its reading within that time.
constexpr double FINE_STEP = 1e-3;
// In a coarser one, a rotor that turns changes its reading where the others change theirs by so many steps.
constexpr double OTHERS_STEPS = 4.0;
// A reading that is held follows another within so long [s]: from their difference the resolution is known.
constexpr double FOLLOWS_S = 0.1;
// Time constant of the means of the squared rotor speeds [s].
constexpr double SQUARES_MEAN_S = 0.3;
// Largest change of a rotor's speed between samples, as a share of it: a constant for the noise, and a rate;
// a motor changes its speed by less than 3 % in a millisecond.
constexpr double JUMP = 0.15, JUMP_PER_S = 20.0;
// Difference between the squares of the two directions of rotation over their sum: clearly unbalanced, and
// balanced again with one reading doubled; of four rotors, and of more in proportion to the share of one.
// Such a rotor reads below this share of the others' speed.
constexpr double UNBALANCED = 0.15, BALANCED = 0.07, HALF_BELOW = 0.6;
// A speed below or above these shares of the others' differs from them.
constexpr double DIFFERS_BELOW = 0.4, DIFFERS_ABOVE = 1.9;
// A rotor below this share of the second fastest reads 0: rotors idle in flight at a quarter of their speed
// in hover (indiflight), and a reading between two samples, one of which is 0, is none.
constexpr double ZERO_BELOW = 0.1;
// Slower rotors [rad/s] are at rest or starting: nothing is said of them.
constexpr double TURNING_RAD_S = 50.0;

// What the checks know of the vehicle, and remember of the samples.
struct Quality {
    std::int64_t rotors;
    double rotor_speed_max;    // rad/s, beyond which a reading is not plausible
    PerRotor rotor_spins;      // ±1
    double frozen_after_s;     // for which an inertial sensor may repeat a reading
    std::int64_t previous_ns;  // stamp of the last usable sample; NO_STAMP before the first
    std::int64_t followed_ns;  // of the last one that was usable but for readings of rotors
    // The last reading of each sensor, and for how long it has not changed.
    Vector3 rates;
    double rates_still_s;
    Vector3 specific_force;
    double specific_force_still_s;
    PerRotor rotor_speeds;
    PerRotor rotor_still_s;
    // Of all rotors, since each of them has not changed.
    std::array<PerRotor, ROTORS_MAX> rotors_lowest;
    std::array<PerRotor, ROTORS_MAX> rotors_highest;
    // The last reading that a rotor held, for how long it has not, and the smallest step between two [rad/s].
    PerRotor rotor_held;
    PerRotor rotor_moves_s;
    double rotor_step;
    PerRotor mean_squares;  // of the rotor speeds, over SQUARES_MEAN_S
    double averaged_s;      // since the means began
};

struct Judgement {
    Faults faults;
    bool usable;
    bool jump;  // the sample comes after a gap or a jump of the clock: nothing may be filtered across
};

template <std::size_t N>
bool all_finite(const std::array<double, N>& values) {
    return std::all_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
}

template <std::size_t N>
bool all_missing(const std::array<double, N>& values) {
    return std::all_of(values.begin(), values.end(), [](double value) { return std::isnan(value); });
}

inline bool all_finite(const Signals& sample, std::int64_t rotors) {
    const double* numbers = numbers_of(sample);
    return std::all_of(numbers, numbers + channels_of(rotors), [](double value) {
        return std::isfinite(value);
    });
}

// The second largest of the rotors' speeds; of one rotor its own.
inline double second_fastest(const PerRotor& speeds, std::int64_t rotors) {
    double first = 0.0, second = 0.0;
    for (int rotor = 0; rotor < rotors; ++rotor) {
        const double speed = speeds[rotor];
        if (speed > first) {
            second = first;
            first = speed;
        } else if (speed > second) {
            second = speed;
        }
    }
    return rotors == 1 ? first : second;
}

// Bits of what is wrong with a stamp, by the step from the last usable one.
inline std::int64_t stamp_faults(bool first, bool jump, std::int64_t step_ns) {
    if (first) {
        return 0;
    }
    if (step_ns == 0) {
        return STAMP_REPEATED;
    }
    if (step_ns < 0) {
        return STAMP_BACKWARD;
    }
    return jump ? std::int64_t{GAP} : 0;
}

// Bits of the topics without which the sample was given up: all their channels are NaN.
inline std::int64_t missing_channels(const Signals& sample, std::int64_t rotors) {
    std::int64_t missing = 0;
    if (all_missing(sample.velocity) && all_missing(sample.attitude)) {
        missing |= STATE_MISSING;
    }
    const auto is_missing = [](double speed) { return std::isnan(speed); };
    if (std::all_of(sample.rotor_speeds.begin(), sample.rotor_speeds.begin() + rotors, is_missing)) {
        missing |= ROTORS_MISSING;
    }
    return missing;
}

// Whether a finite sample can be that of a flight.
inline bool plausible(const Signals& sample, double rotor_speed_max) {
    return unit_attitude(sample.attitude) && within(sample.velocity, AIRSPEED_MAX_M_S) &&
           within(sample.wind, AIRSPEED_MAX_M_S) && usable_imu(sample.rates, sample.specific_force) &&
           std::all_of(sample.rotor_speeds.begin(), sample.rotor_speeds.end(), [=](double speed) {
               return 0.0 <= speed && speed <= rotor_speed_max;
           });
}

// Note whether a rotor's reading is the one before, and the resolution that its changes tell.
inline void take_reading(Quality& memory, int rotor, const PerRotor& speeds, double step_s) {
    const double speed = speeds[rotor], before = memory.rotor_speeds[rotor];
    PerRotor &lowest = memory.rotors_lowest[rotor], &highest = memory.rotors_highest[rotor];
    if (std::min(speed, before) <= TURNING_RAD_S || speed != before) {
        memory.rotor_still_s[rotor] = 0.0;
        memory.rotor_moves_s[rotor] += step_s;
        lowest = speeds;
        highest = speeds;
        return;
    }
    const double step = std::abs(speed - memory.rotor_held[rotor]);
    if (memory.rotor_moves_s[rotor] <= FOLLOWS_S && step > STUCK_RAD_S) {
        memory.rotor_step = std::min(memory.rotor_step, step);
    }
    memory.rotor_held[rotor] = speed;
    memory.rotor_moves_s[rotor] = 0.0;
    memory.rotor_still_s[rotor] += step_s;
    for (int k = 0; k < memory.rotors; ++k) {
        lowest[k] = std::min(lowest[k], speeds[k]);
        highest[k] = std::max(highest[k], speeds[k]);
    }
}

// Whether a rotor that turned would have changed its reading meanwhile, in the resolution of the stream.
//
// It would in a fine one, and wherever the others, but for the least and the most, change by several steps.
inline bool would_change(const Quality& memory, int rotor) {
    if (memory.rotor_step == INF || memory.rotor_step < FINE_STEP * memory.rotor_speeds[rotor]) {
        return true;
    }
    double total = 0.0, least = INF, most = 0.0;
    for (int k = 0; k < memory.rotors; ++k) {
        if (k != rotor) {
            const double extent = memory.rotors_highest[rotor][k] - memory.rotors_lowest[rotor][k];
            total += extent;
            least = std::min(least, extent);
            most = std::max(most, extent);
        }
    }
    const auto between = static_cast<double>(memory.rotors - 3);
    return between > 0.0 && total - least - most >= between * (OTHERS_STEPS * memory.rotor_step);
}

// Note readings of rotors that no flight has, by the balance of the squares of their speeds.
//
// Of one or two rotors there are no others to compare one with.
inline void compare_rotors(const Quality& memory, double total, double balance, Faults& faults) {
    const auto rotors = static_cast<double>(memory.rotors);
    if (memory.rotors < 3 || memory.averaged_s < 2.0 * SQUARES_MEAN_S ||
        total < rotors * TURNING_RAD_S * TURNING_RAD_S) {
        return;
    }
    const double share = 4.0 / rotors;
    for (int k = 0; k < memory.rotors; ++k) {
        if (faults.has(ROTOR_ZERO, k)) {
            continue;
        }
        const double square = memory.mean_squares[k];
        const double relative = std::sqrt((rotors - 1.0) * square / std::max(total - square, 1.0));
        const double doubled =
            std::abs(balance + 3.0 * memory.rotor_spins[k] * square) / (total + 3.0 * square);
        if (std::abs(balance) > share * UNBALANCED * total && doubled < share * BALANCED &&
            relative < HALF_BELOW) {
            faults.add(ROTOR_HALF, k);
        } else if (relative < DIFFERS_BELOW || relative > DIFFERS_ABOVE) {
            faults.add(ROTOR_DIFFERS, k);
        }
    }
}

// Faults of the rotors' readings, which are remembered.
inline Faults rotor_faults(Quality& memory, const PerRotor& speeds, double step_s, bool restarts) {
    Faults faults{};
    const double share = restarts ? 1.0 : step_s / (SQUARES_MEAN_S + step_s);
    double total = 0.0, balance = 0.0;
    const double zero = ZERO_BELOW * second_fastest(speeds, memory.rotors);
    const bool others_turn = zero > ZERO_BELOW * TURNING_RAD_S;
    for (int k = 0; k < memory.rotors; ++k) {
        const double before = memory.rotor_speeds[k];
        if (others_turn && speeds[k] < zero) {
            faults.add(ROTOR_ZERO, k);
        }
        take_reading(memory, k, speeds, step_s);
        if (memory.rotor_still_s[k] >= STUCK_S && would_change(memory, k)) {
            faults.add(ROTOR_FROZEN, k);
        }
        const double larger = std::max(speeds[k], before);
        const double most = (JUMP + JUMP_PER_S * step_s) * larger;
        const bool jumps = !restarts && larger > TURNING_RAD_S && std::abs(speeds[k] - before) > most;
        if (jumps && !faults.has(ROTOR_ZERO, k)) {
            faults.add(ROTOR_JUMPS, k);
        }
        memory.rotor_speeds[k] = speeds[k];
        memory.mean_squares[k] += share * (speeds[k] * speeds[k] - memory.mean_squares[k]);
        total += memory.mean_squares[k];
        balance += memory.rotor_spins[k] * memory.mean_squares[k];
    }
    memory.averaged_s = restarts ? 0.0 : memory.averaged_s + step_s;
    compare_rotors(memory, total, balance, faults);
    return faults;
}

// For how long an inertial sensor has repeated its reading [s], after one more reading.
inline double still_for(
    const Vector3& reading, const Vector3& last, double still_s, double creep, double step_s
) {
    bool equal = true, small = true;
    for (int k = 0; k < 3; ++k) {
        const double change = std::abs(reading[k] - last[k]);
        equal &= change == 0.0;
        small &= change <= creep;
    }
    if (equal) {
        return still_s + step_s;
    }
    return small ? std::max(0.0, still_s - 0.5 * step_s) : 0.0;
}

// Faults of sensors in a usable sample, which is remembered.
inline Faults sensor_faults(Quality& memory, const Signals& sample, double step_s, bool restarts) {
    Faults faults = rotor_faults(memory, sample.rotor_speeds, step_s, restarts);
    memory.rates_still_s = still_for(sample.rates, memory.rates, memory.rates_still_s, CREEP_RAD_S, step_s);
    memory.specific_force_still_s = still_for(
        sample.specific_force, memory.specific_force, memory.specific_force_still_s, CREEP_M_S2, step_s
    );
    memory.rates = sample.rates;
    memory.specific_force = sample.specific_force;
    if (memory.rates_still_s >= memory.frozen_after_s) {
        faults.add(GYRO_FROZEN);
    }
    if (memory.specific_force_still_s >= memory.frozen_after_s) {
        faults.add(ACCELEROMETER_FROZEN);
    }
    return faults;
}

// Judge one sample.
inline Judgement judge(Quality& memory, std::int64_t time_ns, const Signals& sample) {
    const std::int64_t step_ns = time_ns - memory.previous_ns;
    const bool first = memory.previous_ns == NO_STAMP;
    const bool jump = !first && std::abs(step_ns) > MAX_GAP_NS;
    Faults faults = Faults::of(stamp_faults(first, jump, step_ns));
    const std::int64_t missing = missing_channels(sample, memory.rotors);
    faults.add(missing);
    bool possible = false;
    if (all_finite(sample, memory.rotors)) {
        possible = plausible(sample, memory.rotor_speed_max);
        if (!possible) {
            faults.add(NOT_PLAUSIBLE);
        }
    } else if (missing == 0 || !all_finite(sample.specific_force)) {
        faults.add(NOT_FINITE);
    }
    const bool usable = possible && (first || jump || step_ns > 0);
    if (usable) {
        memory.previous_ns = memory.followed_ns = time_ns;
        const bool restarts = first || jump;
        const double step_s = restarts ? 0.0 : static_cast<double>(step_ns) * 1e-9;
        faults.add(sensor_faults(memory, sample, step_s, restarts));
    }
    return {faults, usable, jump};
}

// Give a sample that is not usable the last readings of the rotors that give none.
//
// Returns a bit per such rotor, 0 if none gives a reading, the sample is not usable for other reasons too or
// comes after a gap.
inline std::int64_t take_last_readings(Quality& memory, std::int64_t time_ns, Signals& sample) {
    std::int64_t absent = 0;
    for (int k = 0; k < memory.rotors; ++k) {
        if (!std::isfinite(sample.rotor_speeds[k])) {
            absent |= 1 << k;
            sample.rotor_speeds[k] = memory.rotor_speeds[k];
        }
    }
    const std::int64_t since_ns = time_ns - memory.followed_ns;
    const bool continues = memory.followed_ns != NO_STAMP && 0 < since_ns && since_ns <= MAX_GAP_NS;
    if (absent == 0 || absent == (1 << memory.rotors) - 1 || !continues ||
        !all_finite(sample, memory.rotors) || !plausible(sample, memory.rotor_speed_max)) {
        return 0;
    }
    memory.followed_ns = time_ns;
    return absent;
}

}  // namespace quadpi
