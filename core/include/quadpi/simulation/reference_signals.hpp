// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Signals of references with their first and second derivatives by time; see truth.py.
#pragma once

#include <algorithm>

#include "quadpi/records.hpp"
#include "quadpi/simulation/state.hpp"

namespace quadpi {

// A value with its first and second derivative by time.
using Jet = std::array<double, 3>;

// Start, duration and fade of a window [s].
struct Span {
    double start, duration, fade;
};

// Sine of a jet.
inline Jet sine_jet(double angle, double rate, double curve) {
    const auto [height, slope] = sine_and_cosine(angle);
    return {height, slope * rate, slope * curve - height * rate * rate};
}

// From 0 to 1 by the polynomial of fifth degree that begins and ends without slope and curvature.
inline Jet edge_jet(double since, double duration) {
    const double x = std::min(std::max(since / duration, 0.0), 1.0);
    const double rest = 1.0 - x;
    return {
        x * x * x * (10.0 - x * (15.0 - 6.0 * x)),
        30.0 * x * x * rest * rest / duration,
        60.0 * x * rest * (rest - x) / (duration * duration),
    };
}

// Integral of the edge.
inline double edge_area(double since, double duration) {
    const double x = std::min(std::max(since / duration, 0.0), 1.0);
    const double area = x * x * x * x * (2.5 - x * (3.0 - x)) * duration;
    return area + std::max(since - duration, 0.0);
}

// From 0 to 1 and back to 0 over a window.
inline Jet presence(double since, const Span& window) {
    const Jet rise = edge_jet(since, window.fade);
    const Jet fall = edge_jet(since - window.duration + window.fade, window.fade);
    return {rise[0] - fall[0], rise[1] - fall[1], rise[2] - fall[2]};
}

// A sum of sines whose frequencies [Hz] rise by `sweep` [Hz/s], faded in and out.
inline void wave_jets(
    Records<const double> time,
    double amplitude,
    Records<const double> frequencies,
    Records<const double> phases,
    double sweep,
    const Span& window,
    Records<Jet> jets
) {
    for (std::size_t i = 0; i < time.size; ++i) {
        const double since = time[i] - window.start;
        const auto [size, size_rate, size_curve] = presence(since, window);
        Jet& jet = jets[i];
        jet = {};
        for (std::size_t k = 0; k < frequencies.size; ++k) {
            const auto [wave, wave_rate, wave_curve] = sine_jet(
                2.0 * PI * (frequencies[k] + 0.5 * sweep * since) * since + phases[k],
                2.0 * PI * (frequencies[k] + sweep * since),
                2.0 * PI * sweep
            );
            jet[0] += amplitude * (size * wave);
            jet[1] += amplitude * (size_rate * wave + size * wave_rate);
            jet[2] += amplitude * (size_curve * wave + 2.0 * size_rate * wave_rate + size * wave_curve);
        }
    }
}

// A sum of edges that begin at instants [s] and rise by heights.
inline void edge_jets(
    Records<const double> time,
    Records<const double> instants,
    Records<const double> heights,
    double rise,
    Records<Jet> jets
) {
    for (std::size_t i = 0; i < time.size; ++i) {
        jets[i] = {};
        for (std::size_t k = 0; k < instants.size; ++k) {
            const Jet edge = edge_jet(time[i] - instants[k], rise);
            for (int order = 0; order < 3; ++order) {
                jets[i][order] += heights[k] * edge[order];
            }
        }
    }
}

// North, east and angle, N jets of each, on a circle from a bearing [rad], turning at a rate [rad/s].
inline void orbit_jets(
    Records<const double> time,
    double radius,
    double turn_rate,
    double bearing,
    const Span& window,
    Records<Jet> jets
) {
    const std::size_t count = time.size;
    for (std::size_t i = 0; i < count; ++i) {
        const double since = time[i] - window.start;
        const Jet present = presence(since, window);
        const double angle = turn_rate * (edge_area(since, window.fade) -
                                          edge_area(since - window.duration + window.fade, window.fade));
        const double rate = turn_rate * present[0], curve = turn_rate * present[1];
        const Jet north = sine_jet(bearing + angle + 0.5 * PI, rate, curve);
        const Jet east = sine_jet(bearing + angle, rate, curve);
        for (int order = 0; order < 3; ++order) {
            jets[i][order] = radius * north[order];
            jets[count + i][order] = radius * east[order];
        }
        jets[2 * count + i] = {angle, rate, curve};
    }
}

}  // namespace quadpi
