// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What the poses of motion capture tell a smoother whose delay is uncertain.
#pragma once

#include "quadpi/estimator/corrections.hpp"
#include "quadpi/records.hpp"

namespace quadpi {

// The motion over each step: velocity [m/s] and specific force [m/s²] in the world, body rates [rad/s].
struct StepMotion {
    Vector3 velocity;
    Vector3 rates;
    Vector3 pushed;
};

// Smallest variance of the delay [s²], of stamps that are trusted, and of a velocity [m²/s²] by poses.
struct PoseLimits {
    double delay_variance;
    double velocity_variance;
};

// Information that the poses of each step give of each position [1/m²] and attitude [1/rad²].
//
// As in the filter: an uncertain delay widens a pose, and motion well above its own noise observes it.
// poses: in a step.
inline void pose_information(
    Records<StepMotion> steps,
    const Noise& noise,
    const PoseLimits& limits,
    double poses,
    Records<std::array<double, 2>> found
) {
    double delay = std::max(noise.delay_prior, limits.delay_variance);
    for (std::size_t step = 0; step < steps.size; ++step) {
        const auto& [velocity, rates, pushed] = steps[step];
        const double turned = delay * ANGULAR_ACCELERATION;
        const double position = poses / (noise.position + 0.5 * (delay * delay) * square_of(pushed) / 3.0);
        const double attitude = poses / (noise.attitude + 0.5 * (turned * turned));
        found[step] = {position, attitude};
        const double moving = significance(velocity, 3.0 * limits.velocity_variance);
        const double turning = significance(rates, 3.0 * noise.rates);
        delay = 1.0 / (1.0 / delay + position * (moving * moving * square_of(velocity)) +
                       attitude * (turning * turning * square_of(rates)));
    }
}

}  // namespace quadpi
