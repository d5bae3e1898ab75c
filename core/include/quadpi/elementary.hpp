// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Elementary functions with the same bits on every computer, to two units in the last place.
//
// Those of a C library differ from one to the next, and by processor. Here each is a reduction of the
// argument (Cody and Waite, Software Manual for the Elementary Functions, 1980) and a Taylor series that is
// long enough for a double: additions, multiplications and divisions, which IEEE 754 rounds in one way.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>

namespace quadpi {

constexpr double PI = 3.14159265358979323846;

// A constant as the sum of doubles. The first ones have so few bits that small multiples of them are exact.
struct QuarterTurn {
    static constexpr double FIRST = 0x1.921fb544p+0, SECOND = 0x1.0b4611a6p-34, THIRD = 0x1.3198a2e037073p-69;
};
struct LogarithmOf2 {
    static constexpr double FIRST = 0x1.62e42feep-1, SECOND = 0x1.a39ef35793c76p-33;
};
struct Angle {
    double value, rest;
};
constexpr Angle HALF_PI{0x1.921fb54442d18p+0, 0x1.1a62633145c07p-54};
// Above so many quarter turns multiples are not exact. The remainder by a rounded 2π is off by less then than
// half a unit in the last place of the angle.
constexpr double QUARTER_TURNS_MAX = 1048576.0;
// Beyond these, exp overflows, and underflows to zero.
constexpr double EXPONENT_MAX = 709.782712893384, EXPONENT_MIN = -745.133219101941;
// Up to this what exp has beyond 1 is made up of a power of two and the rest.
constexpr double EXACT_MAX = 40.0;
// Beyond this tanh is 1 to the last bit.
constexpr double TANH_MAX = 20.0;
// What the series leave out is less than 2⁻⁵⁷ of their sums.
constexpr std::size_t SINE_TERMS = 9, EXPONENTIAL_TERMS = 15, ARCTANGENT_TERMS = 7, LOGARITHM_TERMS = 17;
// Arctangents of k/8.
constexpr double ARCTANGENT_STEPS = 8.0;
constexpr std::array<Angle, 9> ARCTANGENTS = {{
    {0.0, 0.0},
    {0x1.fd5ba9aac2f6ep-4, -0x1.cd37686760c17p-59},
    {0x1.f5b75f92c80ddp-3, 0x1.8ab6e3cf7afbdp-57},
    {0x1.6f61941e4def1p-2, -0x1.c63aae6f6e918p-56},
    {0x1.dac670561bb4fp-2, 0x1.a2b7f222f65e2p-56},
    {0x1.1e00babdefeb4p-1, -0x1.928df287a668fp-58},
    {0x1.4978fa3269ee1p-1, 0x1.2419a87f2a458p-56},
    {0x1.700a7c5784634p-1, -0x1.8c34d25aadef6p-56},
    {0x1.921fb54442d18p-1, 0x1.1a62633145c07p-55},
}};

// 1/first!, sign/(first + step)!, 1/(first + 2 step)!, ...
template <std::size_t N>
constexpr std::array<double, N> reciprocal_factorials(int first, int step, double sign) {
    std::array<double, N> coefficients{};
    double factorial = 1.0, own = 1.0;
    int reached = 0;
    for (std::size_t n = 0; n < N; ++n, own *= sign) {
        while (reached < first + static_cast<int>(n) * step) {
            factorial *= ++reached;
        }
        coefficients[n] = own / factorial;
    }
    return coefficients;
}

// first/3, first sign/5, first/7, ...
template <std::size_t N>
constexpr std::array<double, N> odd_reciprocals(double first, double sign) {
    std::array<double, N> coefficients{};
    double own = first;
    for (std::size_t n = 0; n < N; ++n, own *= sign) {
        coefficients[n] = own / (2.0 * static_cast<double>(n) + 3.0);
    }
    return coefficients;
}

// Σ cₙ xⁿ; even and odd powers on their own, side by side.
template <std::size_t N>
double polynomial(const std::array<double, N>& coefficients, double x) {
    const double square = x * x;
    double sum = coefficients[N - 2], other = coefficients[N - 1];
    for (std::size_t n = N - 2; n-- > 0;) {
        const double next = coefficients[n] + square * other;
        other = sum;
        sum = next;
    }
    return sum + x * other;
}

// The nearest whole number, the even one of two; of numbers below 2⁵¹, whose sum with this has no place for
// more.
inline double nearest(double x) {
    constexpr double whole = 0x1.8p+52;
    return (x + whole) - whole;
}

// A power of two, exactly; the exponent of a normal number.
inline double power_of_2(std::int64_t exponent) {
    const std::int64_t bits = (exponent + 1023) << 52;
    double power;
    std::memcpy(&power, &bits, sizeof power);
    return power;
}

// An angle less a whole number of quarter turns, as a sum, and that number, of which the last two bits count.
struct ReducedAngle {
    double value, rest;
    std::int64_t quarter_turns;
};

inline ReducedAngle reduced(double angle) {
    if (!(std::fabs(angle) < QUARTER_TURNS_MAX)) {
        angle = std::fmod(angle, 4.0 * HALF_PI.value);
    }
    const double turns = nearest(angle * (1.0 / HALF_PI.value));
    const double first = angle - turns * QuarterTurn::FIRST, second = turns * QuarterTurn::SECOND;
    const double near = first - second, third = turns * QuarterTurn::THIRD, value = near - third;
    const double rest = ((near - value) - third) + ((first - near) - second);
    return {value, rest, static_cast<std::int64_t>(turns)};
}

// Sine and cosine between -π/4 and π/4.
inline double sine_near_0(const ReducedAngle& angle) {
    constexpr auto coefficients = reciprocal_factorials<SINE_TERMS - 1>(3, 2, -1.0);
    const double square = angle.value * angle.value;
    const double cubic = -square * angle.value * polynomial(coefficients, square);
    return angle.value + (cubic + angle.rest * (1.0 - 0.5 * square));
}

inline double cosine_near_0(const ReducedAngle& angle) {
    constexpr auto coefficients = reciprocal_factorials<SINE_TERMS - 2>(4, 2, -1.0);
    const double square = angle.value * angle.value, half = 0.5 * square, first = 1.0 - half;
    const double others = square * square * polynomial(coefficients, square) - angle.value * angle.rest;
    return first + (((1.0 - first) - half) + others);
}

inline double of_quarter_turn(const ReducedAngle& angle, std::int64_t quarter_turns) {
    const double size = (quarter_turns & 1) != 0 ? cosine_near_0(angle) : sine_near_0(angle);
    return (quarter_turns & 2) != 0 ? -size : size;
}

struct SineAndCosine {
    double sine, cosine;
};

// Sine and cosine of an angle [rad]; NaN of an infinite one.
inline SineAndCosine sine_and_cosine(double angle) {
    const ReducedAngle own = reduced(angle);
    return {of_quarter_turn(own, own.quarter_turns), of_quarter_turn(own, own.quarter_turns + 1)};
}

inline double sine(double angle) {
    const ReducedAngle own = reduced(angle);
    return of_quarter_turn(own, own.quarter_turns);
}

inline double cosine(double angle) {
    const ReducedAngle own = reduced(angle);
    return of_quarter_turn(own, own.quarter_turns + 1);
}

// Angle [rad] between 0 and π/2 of a point with 0 <= y, 0 <= x, not both 0 or infinite.
inline Angle angle_in_quadrant(double y, double x) {
    if (y > x) {
        const Angle other = angle_in_quadrant(x, y);
        const double value = HALF_PI.value - other.value;
        return {value, ((HALF_PI.value - value) - other.value) + (HALF_PI.rest - other.rest)};
    }
    const double slope = y / x;
    const double step = nearest(ARCTANGENT_STEPS * slope), near = step / ARCTANGENT_STEPS;
    double rest = slope;
    if (step != 0.0) {
        // A product by a multiple of 1/8 is exact without the last bits.
        const double scale = power_of_2(30) + 1.0, split = scale * x, coarse = split - (split - x);
        rest = ((y - near * coarse) - near * (x - coarse)) / (x + near * y);
    }
    constexpr auto coefficients = odd_reciprocals<ARCTANGENT_TERMS - 1>(-1.0, -1.0);
    const double square = rest * rest, cubic = rest * square * polynomial(coefficients, square);
    const Angle tabulated = ARCTANGENTS[static_cast<std::size_t>(step)];
    const double value = tabulated.value + rest;
    return {value, ((tabulated.value - value) + rest) + (cubic + tabulated.rest)};
}

// Angle [rad] of the point (x, y), from -π to π; of the origin 0 or π, as x has a sign.
inline double arctangent(double y, double x) {
    double along = std::fabs(x), across = std::fabs(y);
    if (std::isnan(along + across)) {
        return along + across;
    }
    if (std::isinf(along) || std::isinf(across)) {
        along = std::isinf(along) ? 1.0 : 0.0;
        across = std::isinf(across) ? 1.0 : 0.0;
    }
    // Sums and products below neither overflow nor lose bits.
    const double larger = along > across ? along : across;
    if (larger > power_of_2(900) || larger < power_of_2(-900)) {
        const double scale = power_of_2(larger > 1.0 ? -200 : 200);
        along *= scale;
        across *= scale;
    }
    Angle angle{};
    if (across != 0.0) {
        angle = angle_in_quadrant(across, along);
    }
    double size = angle.value + angle.rest;
    if (std::signbit(x)) {
        size = (2.0 * HALF_PI.value - angle.value) + (2.0 * HALF_PI.rest - angle.rest);
    }
    return std::copysign(size, y);
}

// A number less a multiple of ln 2, as a sum, and the multiple.
struct ReducedExponent {
    double value, rest;
    std::int64_t power;
};

inline ReducedExponent reduced_exponent(double exponent) {
    const double power = nearest(exponent * (1.0 / (LogarithmOf2::FIRST + LogarithmOf2::SECOND)));
    const double near = exponent - power * LogarithmOf2::FIRST, second = power * LogarithmOf2::SECOND;
    const double value = near - second;
    return {value, (near - value) - second, static_cast<std::int64_t>(power)};
}

// exp(x) - 1 for a reduced x.
inline double exponential_less_1(const ReducedExponent& exponent) {
    constexpr auto coefficients = reciprocal_factorials<EXPONENTIAL_TERMS - 2>(2, 1, 1.0);
    const double x = exponent.value;
    return x + (x * x * polynomial(coefficients, x) + exponent.rest * (1.0 + x));
}

inline double exponential(double x) {
    if (!(x <= EXPONENT_MAX)) {
        return x + std::numeric_limits<double>::infinity();
    }
    if (x < EXPONENT_MIN) {
        return 0.0;
    }
    const ReducedExponent own = reduced_exponent(x);
    // By two powers, of which each is a normal number.
    const std::int64_t half = own.power / 2;
    return ((1.0 + exponential_less_1(own)) * power_of_2(half)) * power_of_2(own.power - half);
}

// exp(x) - 1, exact near 0.
inline double exponential_minus_1(double x) {
    if (!(std::fabs(x) < EXACT_MAX)) {
        return exponential(x) - 1.0;
    }
    const ReducedExponent own = reduced_exponent(x);
    const double power = power_of_2(own.power);
    return (power - 1.0) + power * exponential_less_1(own);
}

// ln(1 + x) for x from 0 to 1: twice the inverse hyperbolic tangent of x / (2 + x).
inline double logarithm_of_1_plus(double x) {
    constexpr auto coefficients = odd_reciprocals<LOGARITHM_TERMS - 1>(2.0, 1.0);
    const double ratio = x / (2.0 + x), square = ratio * ratio;
    return 2.0 * ratio + ratio * square * polynomial(coefficients, square);
}

// ln x of a positive number.
inline double logarithm(double x) {
    int exponent = 0;
    const double mantissa = 2.0 * std::frexp(x, &exponent);
    const double powers = static_cast<double>(exponent - 1);
    return powers * LogarithmOf2::FIRST +
           (powers * LogarithmOf2::SECOND + logarithm_of_1_plus(mantissa - 1.0));
}

inline double hyperbolic_tangent(double x) {
    const double size = std::fabs(x);
    if (size > TANH_MAX) {
        return std::copysign(1.0, x);
    }
    const double grown = exponential_minus_1(2.0 * size);
    return std::copysign(grown / (grown + 2.0), x);
}

}  // namespace quadpi
