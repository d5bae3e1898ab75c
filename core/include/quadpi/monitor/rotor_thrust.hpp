// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Whether a rotor has stopped, or only its telemetry: the measured wrench tells whether its thrust is gone;
// see monitor/alarm_kernel.py.
#pragma once

#include "quadpi/monitor/preparation.hpp"

namespace quadpi {

// Least and largest loss of a rotor that has stopped, as shares of its thrust, in each of Fz, Mx and My.
constexpr double LOST_SHARE = 0.5, LOST_MOST = 2.0;
// Time [s] for which a rotor's thrust is gone until it is called stopped, and that of one that gives no
// reading.
constexpr double LOST_S = 0.04, SILENT_LOST_S = 0.06;
// Spread of a rotor's thrust, over its mean, up to which its loss tells without a reading.
constexpr double STEADY_SHARE = 0.4;
// Thrust of the other rotors, over their mean, from which on the loss of one tells without a reading.
constexpr double TOGETHER_SHARE = 0.5;
// Time [s] for which a rotor reads 0 until its telemetry is called wrong.
constexpr double UNDECIDED_S = 0.2;
// Time constant [s] of the means; a mean of less than this time in flight says nothing.
constexpr double THRUST_MEAN_S = 0.5, KNOWN_S = 0.2;
// A reading of 0 is reported for this long [s] after it: the telemetry fails, though it may come back.
constexpr double REPORTED_S = 0.5;
// A rotor whose thrust is back for this long [s] turns again.
constexpr double BACK_S = 0.5;
// Difference of the levers of two rotors on one arm, over the longest.
constexpr double ALIKE_SHARE = 0.1;
// Fz, Mx, My of a wrench.
constexpr std::array<int, 3> SHOWN = {2, 3, 4};

// What is known of the rotors.
struct RotorGeometry {
    std::int64_t rotors;
    double thrust_per_square;  // N/(rad/s)², from hover; 0 where unknown: then no rotor is called stopped
    double least_square;       // (rad/s)², below which a rotor's thrust is too small to be missed
    std::array<Vector3, ROTORS_MAX> lever;  // change of Fz, Mx, My per newton that a rotor loses: 1, m, m
};

// What is remembered of the samples.
struct RotorThrust {
    std::int64_t stopped;   // bit per rotor
    PerRotor mean_squares;  // (rad/s)², while it reads more than 0
    PerRotor variances;     // of the squares, about their means
    Vector3 mean_rest;      // Fz, Mx, My that the rotors do not explain
    double known_s;         // since the means began
    PerRotor lost_s;        // for which its thrust has been gone, less the time for which it was not
    PerRotor back_s;        // for which the thrust of a stopped rotor has been back
    PerRotor zero_s;        // since readings of 0, or none, began
    PerRotor since_zero_s;  // since the last one
    std::int64_t zeros;     // bit per rotor whose last such reading was a 0
};

// Whether rotors act on the body alike, as two on one arm do.
inline bool act_alike(const RotorGeometry& geometry, int a, int b) {
    const Vector3 &one = geometry.lever[a], &other = geometry.lever[b];
    const double reach = std::max(std::abs(one[1]), std::abs(one[2]));
    return std::abs(one[1] - other[1]) <= ALIKE_SHARE * reach &&
           std::abs(one[2] - other[2]) <= ALIKE_SHARE * reach;
}

// Begin anew, as on the ground.
inline void forget_thrust(RotorThrust& thrust) {
    thrust.stopped = 0;
    thrust.known_s = 0.0;
    thrust.mean_squares = {};
    thrust.variances = {};
    thrust.lost_s = {};
    thrust.back_s = {};
    thrust.zero_s = {};
    thrust.since_zero_s.fill(INF);
}

// Whether there are rotors, one bit each, and all of them have stopped.
inline bool are_stopped(const RotorThrust& thrust, std::int64_t rotors) {
    return rotors != 0 && (rotors & ~thrust.stopped) == 0;
}

// Compare the wrench with squared rotor speeds, or begin anew where they are not known: step 0.
//
// A rotor without a reading is judged while its own thrust was steady, and the others carry as before.
inline void find_stopped(
    const RotorGeometry& geometry,
    RotorThrust& thrust,
    const PerRotor& squares,
    const Wrench& wrench,
    double step_s,
    bool carries
) {
    if (step_s == 0.0 && thrust.stopped == 0) {
        thrust.known_s = 0.0;
        thrust.lost_s = {};
        return;
    }
    Vector3 change;
    for (std::size_t shown = 0; shown < SHOWN.size(); ++shown) {
        double rest = wrench[SHOWN[shown]];
        for (int k = 0; k < geometry.rotors; ++k) {
            rest += geometry.thrust_per_square * squares[k] * geometry.lever[k][shown];
        }
        change[shown] = rest - thrust.mean_rest[shown];
    }
    bool suspected = thrust.stopped != 0, silent_lost = false;
    for (int k = 0; k < geometry.rotors; ++k) {
        double least = INF, most = -INF;
        const bool silent = thrust.since_zero_s[k] == 0.0;
        const double mean = thrust.mean_squares[k];
        const bool steady = thrust.variances[k] <= STEADY_SHARE * STEADY_SHARE * (mean * mean);
        const bool judged = squares[k] >= geometry.least_square && geometry.least_square > 0.0 &&
                            thrust.known_s >= KNOWN_S && (!silent || (steady && carries));
        if (judged) {
            const double expected = geometry.thrust_per_square * squares[k];
            const double roll = geometry.lever[k][1], pitch = geometry.lever[k][2];
            for (std::size_t shown = 0; shown < SHOWN.size(); ++shown) {
                const double lever = geometry.lever[k][shown];
                if (lever == 0.0) {
                    // A rotor on an axis does not turn the body about it: that is the loss of another one.
                    const double turn = LOST_SHARE * std::max(std::abs(roll), std::abs(pitch)) * expected;
                    least = std::abs(change[shown]) > turn ? -INF : least;
                    continue;
                }
                const double share = change[shown] / (lever * expected);
                least = std::min(least, share);
                most = std::max(most, share);
            }
        }
        const bool is_lost = judged && least >= LOST_SHARE && most <= LOST_MOST;
        thrust.lost_s[k] = std::max(0.0, thrust.lost_s[k] + (is_lost ? step_s : -step_s));
        if (thrust.stopped & 1 << k) {
            const bool is_back = judged && most < 0.5 * LOST_SHARE && !silent;
            thrust.back_s[k] = is_back ? thrust.back_s[k] + step_s : 0.0;
            if (thrust.back_s[k] >= BACK_S) {
                forget_thrust(thrust);
                return;
            }
        }
        suspected = suspected || thrust.lost_s[k] > 0.0 || silent;
        silent_lost = silent_lost || (silent && is_lost);
    }
    for (int k = 0; k < geometry.rotors && thrust.stopped == 0; ++k) {
        const bool silent = thrust.since_zero_s[k] == 0.0;
        // Where one without a reading explains the loss, it is not a neighbour's that turns.
        if (thrust.lost_s[k] >= (silent ? SILENT_LOST_S : LOST_S) && (silent || !silent_lost)) {
            for (int j = 0; j < geometry.rotors; ++j) {
                const bool alike = (thrust.since_zero_s[j] == 0.0) == silent && act_alike(geometry, j, k);
                thrust.stopped |= static_cast<std::int64_t>(alike) << j;
            }
        }
    }
    if (suspected) {
        return;
    }
    const double share = step_s / (std::min(thrust.known_s, THRUST_MEAN_S) + step_s);
    thrust.known_s += step_s;
    for (std::size_t shown = 0; shown < SHOWN.size(); ++shown) {
        thrust.mean_rest[shown] += share * change[shown];
    }
    for (int k = 0; k < geometry.rotors; ++k) {
        const double off = squares[k] - thrust.mean_squares[k];
        thrust.variances[k] += share * (off * off - thrust.variances[k]);
        thrust.mean_squares[k] += share * off;
    }
}

// Faults with a reading of 0 reported once it is decided that the thrust is there, and for a while.
inline Faults named_faults(const RotorThrust& thrust, const Faults& faults, std::int64_t rotors) {
    Faults named = faults;
    named.keep(~every_rotor(ROTOR_ZERO));
    if (thrust.stopped != 0) {
        // Rotors are no longer compared: one that is slow may balance the one that stopped.
        named.keep(~ROTOR_FAULTS);
        for (int k = 0; k < rotors; ++k) {
            for (const Fault own : {ROTOR_FROZEN, ROTOR_JUMPS}) {
                if (!(thrust.stopped & 1 << k) && faults.has(own, k)) {
                    named.add(own, k);
                }
            }
        }
        return named;
    }
    for (int k = 0; k < rotors; ++k) {
        const bool is_reported = thrust.since_zero_s[k] <= REPORTED_S && thrust.zero_s[k] >= UNDECIDED_S;
        if (is_reported && thrust.zeros & 1 << k) {
            named.add(ROTOR_ZERO, k);
        }
    }
    return named;
}

// Take a sample in flight that is usable, or but for absent rotors, with its measured wrench.
//
// step_s: since the sample before.
// Returns its faults, with what readings of 0 mean.
inline Faults follow_thrust(
    const RotorGeometry& geometry,
    RotorThrust& thrust,
    const Verdict& sample,
    const Wrench& wrench,
    double step_s
) {
    const Faults& faults = sample.faults;
    if (faults.any(every_rotor(ROTOR_JUMPS) | GAP) && sample.usable && thrust.stopped == 0) {
        // A reading that was wrong, or is now, or none for long: what the means know is worth nothing.
        thrust.known_s = 0.0;
    }
    bool unknown = false;
    double now = 0.0, before = 0.0;
    PerRotor squares{};
    for (int k = 0; k < geometry.rotors; ++k) {
        squares[k] = sample.rotor_speeds[k] * sample.rotor_speeds[k];
        const bool reads_zero = faults.has(ROTOR_ZERO, k);
        const std::int64_t own = 1 << k;
        if (reads_zero || sample.absent & own) {
            thrust.zeros = reads_zero ? thrust.zeros | own : thrust.zeros & ~own;
            thrust.zero_s[k] += step_s;
            thrust.since_zero_s[k] = 0.0;
            unknown = unknown || thrust.zero_s[k] > UNDECIDED_S;
            squares[k] = thrust.mean_squares[k];
        } else {
            now += squares[k];
            before += thrust.mean_squares[k];
            thrust.since_zero_s[k] += step_s;
            if (thrust.since_zero_s[k] > REPORTED_S) {
                thrust.zero_s[k] = 0.0;
            } else if (thrust.zero_s[k] > 0.0) {
                thrust.zero_s[k] += step_s;
            }
        }
    }
    const bool carries = now >= TOGETHER_SHARE * before;
    find_stopped(geometry, thrust, squares, wrench, unknown ? 0.0 : step_s, carries);
    return named_faults(thrust, faults, geometry.rotors);
}

}  // namespace quadpi
