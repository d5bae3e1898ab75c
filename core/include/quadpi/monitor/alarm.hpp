// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// How a sample changes the alarm; see monitor/alarm.py.
#pragma once

#include "quadpi/monitor/change.hpp"
#include "quadpi/monitor/extrapolation.hpp"

namespace quadpi {

// Charge that BAD_DATA starts with, and from which on it and MISCOVERAGE are a warning.
constexpr double WARNING_CHARGE = 0.5;
// Sums of steps such as 50 × 0.02 miss 1 by rounding.
constexpr double ROUNDING = 1e-9;
// A gap between samples counts as this long [s], as nothing is known of what happened in it.
constexpr double STEP_MAX_S = 0.02;
// The cumulative sum of MISCOVERAGE stops at this multiple of its limit, so that it comes down again soon;
// at or below the second one, its alarm or warning is cleared.
constexpr double SUM_MOST = 1.5, SUM_OVER = 0.25;
// Time constant [s] of the published share of misses.
constexpr double SHARE_S = 2.0;
// After this long without a usable sample [s], the model is not judged.
constexpr double SILENT_S = 0.1;

// Evidence [to 1] at which 5 % of sound flights raise CHANGE: see FALSE_FLIGHTS in models/alarm_limits.py.
constexpr double STATED_EVIDENCE = 20.0;

// For this long after a sample beyond a warning of EXTRAPOLATION [s] a manoeuvre is unlike those of training.
constexpr double UNLIKE_S = 2.0;
// For so long after an alarm of EXTRAPOLATION [s] nothing counts against the vehicle: what is left of errors
// there lasts, and of ten faster flights four raised CHANGE on it.
constexpr double BEYOND_S = 1.0;

// Python's floor division, by a positive number.
inline std::int64_t floor_divided(std::int64_t value, std::int64_t by) {
    return value / by - (value % by < 0 ? 1 : 0);
}

// Level of a cause with one charge, from how full it is.
inline std::int64_t level_of(double charge, double empty, std::int64_t before) {
    if (charge >= 1.0 - ROUNDING) {
        return LEVEL_ALARM;
    }
    if (charge <= empty + ROUNDING) {
        return LEVEL_OK;
    }
    return charge >= WARNING_CHARGE && before == LEVEL_OK ? LEVEL_WARNING : before;
}

// Whether a level is raised that a full charge raises and an empty one clears.
inline bool is_raised(double charge, bool was_raised) {
    return charge >= 1.0 - ROUNDING || (was_raised && charge > ROUNDING);
}

// Level of EXTRAPOLATION: an alarm and a warning, each by its own charge.
inline std::int64_t level_of_two(double far, double near, std::int64_t before) {
    if (is_raised(far, before == LEVEL_ALARM)) {
        return LEVEL_ALARM;
    }
    return is_raised(near, before != LEVEL_OK) ? LEVEL_WARNING : LEVEL_OK;
}

// Decide whether the vehicle flies, and with all rotors; returns the faults that count there.
//
// On the ground the evidence against the model is forgotten.
inline Faults follow_vehicle(
    const AlarmLimits& limits, AlarmState& state, const Verdict& sample, const Wrench& measured, double step_s
) {
    follow_ground(state.ground, limits.hover_square, sample, limits.rotors.rotors, step_s);
    if (state.ground.flying) {
        return follow_thrust(limits.rotors, state.thrust, sample, measured, step_s);
    }
    forget_thrust(state.thrust);
    state.miss_sum_s = {};
    state.miss_share = {};
    state.charge[EXTRAPOLATION] = state.charge[MISCOVERAGE] = state.near_charge = 0.0;
    forget_change(state.change);
    state.charge[CHANGE] = 0.0;
    return sample.faults;
}

// Note why the model is not judged, and for what share of the time.
inline void count_time(AlarmState& state, double step_s) {
    AlarmRow& row = state.row;
    if (state.silent_s >= SILENT_S) {
        row.why_not_judged = NO_SAMPLES;
    } else if (state.ground.why == JUDGED && !state.settled) {
        row.why_not_judged = SETTLES;
    } else if (state.ground.why == JUDGED && state.wind_unknown) {
        row.why_not_judged = WIND_UNKNOWN;
    } else {
        row.why_not_judged = state.ground.why;
    }
    state.since_first_s += step_s;
    if (row.why_not_judged != JUDGED) {
        state.not_judged_s += step_s;
    }
    row.not_judged_share = state.since_first_s > 0.0 ? state.not_judged_s / state.since_first_s : 1.0;
}

// Advance the sequential test of each axis; while the state settles, that of Fz alone, and
// those of Fx and Fy not until the wind is known.
inline void judge_miscoverage(
    const AlarmLimits& limits,
    AlarmState& state,
    const Wrench& measured,
    const Wrench& lower,
    const Wrench& upper,
    double step_s
) {
    AlarmRow& row = state.row;
    double worst = 0.0;
    // Where the model is known not to hold, misses tell nothing of the vehicle.
    const bool beyond = state.extrapolates && row.cause_level[EXTRAPOLATION] == LEVEL_ALARM;
    const double keep = SHARE_S / (SHARE_S + step_s);
    for (int axis = 0; axis < AXES; ++axis) {
        const double limit = limits.miscoverage_s[axis];
        if (limit == INF) {
            continue;
        }
        const bool blown = state.wind_unknown && (axis == FX || axis == FY);
        if (!beyond && ((state.settled && !blown) || axis == FZ)) {
            const double half = 0.5 * (upper[axis] - lower[axis]) * limits.interval_ratio[axis];
            const double miss =
                std::abs(measured[axis] - 0.5 * (upper[axis] + lower[axis])) > half ? 1.0 : 0.0;
            const double total = state.miss_sum_s[axis] + step_s * (miss - limits.allowance);
            state.miss_sum_s[axis] = std::min(std::max(total, 0.0), SUM_MOST * limit);
            state.miss_share[axis] = keep * state.miss_share[axis] + (1.0 - keep) * miss;
            raise_to(row.miss_share[axis], state.miss_share[axis]);
        }
        const double score = state.miss_sum_s[axis] / limit;
        raise_to(worst, score);
        raise_to(row.miscoverage[axis], score);
    }
    state.charge[MISCOVERAGE] = worst;
}

// Gather evidence that the vehicle has changed, where wind and sensors are known and the state has settled;
// with inputs that the model does not know, of a load alone, while the interval of Fz is within its limit.
inline void judge_change(
    const AlarmLimits& limits,
    AlarmState& state,
    const Verdict& sample,
    const InputVector& inputs,
    const Wrench& measured,
    const Wrench& lower,
    const Wrench& upper,
    double step_s
) {
    Change& change = state.change;
    if (limits.change.evidence == 0.0) {
        forget_change(change);
        state.charge[CHANGE] = 0.0;
        return;
    }
    const std::int64_t number = floor_divided(sample.time_ns, BLOCK_NS);
    end_block(change.within, number, [&] {
        take_block(limits.change, limits.rotors, change);
        take_load(limits.change, change.within.sum, change);
    });
    end_block(change.beyond, number, [&] { take_load(limits.change, change.beyond.sum, change); });
    change.unlike_s = std::max(state.extrapolates ? UNLIKE_S : 0.0, change.unlike_s - step_s);
    if (state.extrapolates && state.row.cause_level[EXTRAPOLATION] == LEVEL_ALARM) {
        change.unlike_s = UNLIKE_S + BEYOND_S;
        double& first = change.onsets[0].prior;  // such a flight may differ from its start on
        first = first == FROM_START && !change.raised ? 0.0 : first;
        change.spent = std::max(change.spent, FROM_START);
    }
    const bool within = !state.extrapolates && change.unlike_s <= UNLIKE_S;
    if (state.settled && !state.wind_unknown && !sample.faults.any() && (within || state.thrust_known)) {
        Wrench error;
        for (int axis = 0; axis < AXES; ++axis) {
            error[axis] = measured[axis] - 0.5 * (lower[axis] + upper[axis]);
        }
        Gathered& gathered = within ? change.within : change.beyond;
        add_to_block(gathered, error, error[FZ] - measured[FZ], sample.rotor_speeds, inputs, step_s);
    }
    state.charge[CHANGE] = change.raised ? 1.0 : 0.0;
    raise_to(state.row.cause_evidence[CHANGE], change.score);
}

// Raise MISCOVERAGE for a rotor without thrust, which contradicts every model of all.
inline void judge_rotors(AlarmState& state) {
    AlarmRow& row = state.row;
    if (state.thrust.stopped != 0) {
        state.charge[MISCOVERAGE] = SUM_MOST;
        row.stopped |= state.thrust.stopped;
    }
    raise_to(row.cause_evidence[MISCOVERAGE], state.charge[MISCOVERAGE]);
}

// Charge BAD_DATA; returns the faults of the sample that count where the vehicle is.
inline Faults judge_data(
    const AlarmLimits& limits, AlarmState& state, const Verdict& sample, Faults faults, double step_s
) {
    AlarmRow& row = state.row;
    double charge = state.charge[BAD_DATA];
    if (!state.ground.flying) {
        faults.keep(~IN_FLIGHT_ONLY);
    }
    bool judged = sample.usable;
    if (are_stopped(state.thrust, sample.absent)) {
        // No reading of a rotor that has stopped is no fault: what was said of it is taken back.
        faults.keep(~std::int64_t{NOT_FINITE | ROTORS_MISSING | GAP});
        judged = true;
        charge = 0.0;
    }
    const bool bad = faults.any() || !judged;
    if (bad) {
        raise_to(charge, WARNING_CHARGE);
    }
    charge = charged(charge, bad, step_s, limits);
    if (state.ground.why == CARRIED) {
        raise_to(charge, WARNING_CHARGE);
    }
    state.charge[BAD_DATA] = charge;
    raise_to(row.cause_evidence[BAD_DATA], charge);
    row.faults.add(faults);
    return faults;
}

// Health of CHANGE, which has a stated rate of its own.
inline std::int64_t health_of_change(const AlarmLimits& limits, const AlarmState& state) {
    if (limits.change.evidence == 0.0 || state.silent_s >= SILENT_S) {
        return UNAVAILABLE;
    }
    if (state.ground.why != JUDGED || !state.settled || state.wind_unknown) {
        return WAITING;
    }
    // Of a limit that a sound flight has set no share is stated.
    return state.change.loud || state.change.unlike_s > 0.0 || limits.change.evidence > STATED_EVIDENCE
               ? UNCALIBRATED
               : ACTIVE;
}

// Set level and health of each cause, and the highest level; true if any of a cause changed.
inline bool set_levels(const AlarmLimits& limits, AlarmState& state) {
    AlarmRow& row = state.row;
    std::int64_t health_of_model =
        state.ground.why == JUDGED ? limits.health_in_flight : std::int64_t{WAITING};
    if (state.silent_s >= SILENT_S) {
        health_of_model = UNAVAILABLE;
    }
    bool changed = false;
    row.level = LEVEL_OK;
    row.causes = 0;
    for (int cause = 0; cause < CAUSES; ++cause) {
        std::int64_t health = cause == BAD_DATA ? std::int64_t{ACTIVE} : health_of_model;
        if (cause == MISCOVERAGE && !state.settled && health != UNAVAILABLE) {
            health = WAITING;
        }
        if (cause == CHANGE) {
            health = health_of_change(limits, state);
        }
        const double charge = state.charge[cause];
        const std::int64_t before = row.cause_level[cause];
        const std::int64_t level = cause == EXTRAPOLATION
                                       ? level_of_two(charge, state.near_charge, before)
                                       : level_of(charge, cause == MISCOVERAGE ? SUM_OVER : 0.0, before);
        changed |= level != before || health != row.cause_health[cause];
        row.cause_level[cause] = level;
        row.cause_health[cause] = health;
        row.level = std::max(row.level, level);
        if (level != LEVEL_OK) {
            row.causes |= 1 << cause;
        }
    }
    return changed;
}

// Remember what the row reports, and clear its evidence; levels and health stay.
inline void begin_next_row(const AlarmLimits& limits, AlarmState& state) {
    AlarmRow& row = state.row;
    for (int k = 0; k < INPUTS; ++k) {
        if (1.0 + 2.0 * row.input_excess[k] > limits.near_distance[k]) {
            state.reported_inputs |= std::int64_t{1} << k;
        }
    }
    state.reported_faults.add(row.faults);
    row.faults = {};
    row.stopped = 0;
    row.cause_evidence = {};
    row.leverage = {};
    row.width = {};
    row.miscoverage = {};
    row.miss_share = {};
    row.input_score = {};
    row.input_excess = {};
}

// Take K samples, of which U are usable; fill the rows to publish, up to K, and return their number.
//
// inputs, measured, said: of the U usable samples.
inline std::size_t advance(
    const AlarmLimits& limits,
    AlarmState& state,
    Records<const Verdict> verdicts,
    Records<const InputVector> inputs,
    Records<const Wrench> measured,
    const Evaluations& said,
    Records<AlarmRow> rows
) {
    std::size_t count = 0, used = 0;
    for (const Verdict& sample : verdicts) {
        const std::int64_t before_ns = state.previous_ns;
        const bool first = before_ns == NO_STAMP;
        double step_s = 0.0;
        if (!first) {
            step_s =
                std::min(std::max(static_cast<double>(sample.time_ns - before_ns) * 1e-9, 0.0), STEP_MAX_S);
        }
        state.previous_ns = sample.time_ns;
        std::int64_t beyond = 0;
        Faults faults = sample.faults;
        const std::int64_t stopped = state.thrust.stopped, why = state.row.why_not_judged;
        if (sample.usable) {
            state.silent_s = 0.0;
            state.settled = sample.settled;
            state.wind_unknown = sample.wind_unknown;
            const Wrench& wrench = measured[used];
            faults = follow_vehicle(limits, state, sample, wrench, step_s);
            if (state.ground.flying) {
                if (state.ground.why == JUDGED) {
                    const Wrench &lower = said.lower[used], &upper = said.upper[used];
                    const InputVector& own = inputs[used];
                    const InputVector by_load = inputs_by_load(own, wrench[FZ], lower[FZ], upper[FZ]);
                    // Until the wind is told, intervals are as wide as it is unsure.
                    const Wrench widths = sample.wind_unknown ? Wrench{} : said.relative_width[used];
                    beyond =
                        judge_extrapolation(limits, state, own, by_load, said.leverage[used], widths, step_s);
                    judge_miscoverage(limits, state, wrench, lower, upper, step_s);
                    judge_change(limits, state, sample, own, wrench, lower, upper, step_s);
                }
                judge_rotors(state);
            }
            ++used;
        } else {
            state.silent_s += step_s;
            if (sample.absent != 0 && state.ground.flying) {
                faults = follow_thrust(limits.rotors, state.thrust, sample, sample.wrench, step_s);
                judge_rotors(state);
            }
        }
        faults = judge_data(limits, state, sample, faults, step_s);
        count_time(state, step_s);

        bool is_due = set_levels(limits, state) || first;
        is_due |= state.thrust.stopped != stopped || state.row.why_not_judged != why;
        is_due |=
            floor_divided(sample.time_ns, limits.period_ns) != floor_divided(before_ns, limits.period_ns);
        if (state.row.level == LEVEL_OK) {
            state.reported_inputs = 0;
            state.reported_faults = {};
        } else {
            is_due |= (beyond & ~state.reported_inputs) != 0 || faults.any_beyond(state.reported_faults);
        }
        if (is_due) {
            state.row.time_ns = sample.time_ns;
            state.row.change = state.change.found;
            rows[count] = state.row;
            ++count;
            begin_next_row(limits, state);
        }
    }
    return count;
}

}  // namespace quadpi
