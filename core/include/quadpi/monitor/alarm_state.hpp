// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Limits and state of the alarm; see monitor/alarm.py.
#pragma once

#include "quadpi/monitor/change_state.hpp"
#include "quadpi/monitor/ground.hpp"
#include "quadpi/monitor/rotor_thrust.hpp"

namespace quadpi {

enum Level : std::int64_t { LEVEL_OK, LEVEL_WARNING, LEVEL_ALARM };
// Health of a cause; see results.py.
enum Health : std::int64_t { ACTIVE, WAITING, UNAVAILABLE, UNCALIBRATED };
// Columns of the causes; the bit of each in a row is 1 << column.
enum Cause : int { EXTRAPOLATION, MISCOVERAGE, BAD_DATA, CHANGE, CAUSES };

using PerCause = std::array<double, CAUSES>;
using WholePerCause = std::array<std::int64_t, CAUSES>;

// Limits of the signals, `near_` those of a warning, and the times that the alarm follows them in.
//
// The distance of an input is from the middle of its training range, in half widths: 1 at the ends.
struct AlarmLimits {
    InputVector lower;
    InputVector upper;
    InputVector scale;  // width of the training range
    InputVector distance;
    InputVector near_distance;
    Wrench leverage;
    Wrench near_leverage;
    Wrench width;
    Wrench near_width;
    Wrench
        miscoverage_s;  // of the cumulative sum of misses; infinite for an axis that the model does not hold
    Wrench interval_ratio;  // width of the intervals that the limits were calibrated with over that of those
                            // used
    double allowance;       // share of misses at which the sum neither rises nor falls
    double persistence_s;
    double release_s;
    double hover_square;  // (rad/s)², squared rotor speed in hover; 0 where unknown
    RotorGeometry rotors;
    std::int64_t period_ns;         // of the rows between changes
    std::int64_t health_in_flight;  // ACTIVE, or UNCALIBRATED
    ChangeLimits change;
};

// An alarm row as it is published; its evidence and faults are those since the row before it.
struct AlarmRow {
    std::int64_t time_ns;
    std::int64_t level;
    std::int64_t causes;
    WholePerCause cause_level;
    WholePerCause cause_health;
    PerCause cause_evidence;
    Wrench leverage;
    Wrench width;
    Wrench miscoverage;
    Wrench miss_share;
    InputVector input_score;
    InputVector input_excess;
    Faults faults;
    std::int64_t stopped;         // bit per rotor
    std::int64_t why_not_judged;  // see WhyNotJudged
    double not_judged_share;      // of the time since the first sample
    ChangeFound change;
};

// All that the alarm remembers.
struct AlarmState {
    AlarmRow row;  // the next one
    // Evidence that has gathered, 0 to 1. Of EXTRAPOLATION there is one more charge, for its warning; that of
    // MISCOVERAGE is its largest score, at most SUM_MOST.
    PerCause charge;
    double near_charge;
    Wrench miss_sum_s;  // cumulative sum of the sequential test
    Wrench miss_share;
    double silent_s;  // since the last usable sample
    Ground ground;
    RotorThrust thrust;
    double since_first_s;      // since the first sample
    double not_judged_s;       // of that, for which the model was not judged
    std::int64_t previous_ns;  // stamp of the last sample; NO_STAMP before the first
    bool settled;              // whether the misses of the last usable sample counted
    bool wind_unknown;         // whether those of the horizontal forces did not, as of a change
    std::int64_t
        reported_inputs;     // bits of the inputs outside that rows have reported since the level was last ok
    Faults reported_faults;  // the same for faults
    bool extrapolates;       // whether the last usable sample lies beyond a limit of a warning
    bool thrust_known;       // whether the interval of Fz is within its limit all the same
    Change change;
};

// What the model says of U usable samples, with its own intervals.
struct Evaluations {
    Records<const Wrench> lower;
    Records<const Wrench> upper;
    Records<const Wrench> leverage;
    Records<const Wrench> relative_width;
};

}  // namespace quadpi
