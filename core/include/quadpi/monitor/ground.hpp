// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Whether the vehicle flies, from rotors, motion and specific force together; see monitor/alarm_kernel.py.
#pragma once

#include "quadpi/monitor/preparation.hpp"

namespace quadpi {

// Shares of the weight, as squares of the rotor speed in hover: that rotors carry in flight, below which they
// do not carry the vehicle, and below which they are at rest or without telemetry.
constexpr double LIFTED = 0.9, TURNING = 0.2, RESTING = 0.01;
// Speed [m/s], rate [rad/s], difference of the specific force from that at rest [g], and way [m], of a
// vehicle that moves.
constexpr double MOVES_M_S = 0.3, MOVES_RAD_S = 0.5, MOVES_G = 0.2, GONE_M = 0.2;
// Specific force [g] of a vehicle that something else than its rotors carries, and time [s] until it has
// landed.
constexpr double SUPPORTED_G = 0.6, SUPPORTED_S = 0.3;
// Time [s] after which the way is forgotten, and for which a vehicle must move to be called carried.
constexpr double WAY_S = 5.0, CARRIED_S = 0.3;

// Why a model is not judged.
enum WhyNotJudged : std::int64_t {
    JUDGED,
    PARKED,
    IDLES,
    CARRIED,
    MOVED,
    NO_SAMPLES,
    SETTLES,
    LANDS,
    WIND_UNKNOWN
};

// What is remembered of the samples.
struct Ground {
    bool flying;
    std::int64_t why;    // why the vehicle is not judged, JUDGED while it surely flies
    double supported_s;  // for which something else than the rotors has carried it
    double moving_s;     // for which it has moved, up to a limit, less the time at rest
    Vector3 way;         // m, gone in the last few seconds, world
};

// Take a usable sample with its filtered signals.
//
// hover_square: (rad/s)², of the rotor speed in hover; 0 where unknown: then the vehicle always flies.
// step_s: since the sample before.
inline void follow_ground(
    Ground& ground, double hover_square, const Verdict& sample, std::int64_t rotors, double step_s
) {
    const double keep = WAY_S / (WAY_S + step_s);
    for (int k = 0; k < 3; ++k) {
        ground.way[k] = keep * (ground.way[k] + step_s * sample.velocity[k]);
    }
    const double force = length_of(sample.specific_force) / STANDARD_GRAVITY;
    const bool moves = length_of(sample.velocity) >= MOVES_M_S || length_of(sample.rates) >= MOVES_RAD_S ||
                       std::abs(force - 1.0) >= MOVES_G || length_of(ground.way) >= GONE_M;
    ground.moving_s = std::min(std::max(ground.moving_s + (moves ? step_s : -step_s), 0.0), 2.0 * CARRIED_S);
    const double speed = second_fastest(sample.rotor_speeds, rotors), square = speed * speed;
    if (!ground.flying) {
        ground.flying = square >= (moves ? TURNING : LIFTED) * hover_square;
        ground.supported_s = 0.0;
    } else if (square < TURNING * hover_square && force >= SUPPORTED_G) {
        ground.supported_s += step_s;
        ground.flying = ground.supported_s < SUPPORTED_S;
    } else {
        ground.supported_s = 0.0;
    }
    if (ground.flying) {
        ground.why = ground.supported_s > 0.0 ? LANDS : JUDGED;
    } else if (square >= RESTING * hover_square) {
        ground.why = ground.moving_s >= CARRIED_S ? MOVED : IDLES;
    } else {
        ground.why = ground.moving_s >= CARRIED_S ? CARRIED : PARKED;
    }
}

}  // namespace quadpi
