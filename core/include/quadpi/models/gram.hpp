// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Sums of products of regressors over samples; see models/least_squares.py.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "quadpi/models/regressors.hpp"

namespace quadpi {

// Samples per block: the regressors of one block stay in the cache of a core.
constexpr std::size_t GRAM_BLOCK = 192;
// Rows and columns of a tile of products, whose sums stay in registers.
constexpr std::size_t TILE_ROWS = 4, TILE_COLUMNS = 2;

// Four numbers that are added side by side, on every processor.
constexpr std::size_t LANES = 4;
using Lanes [[gnu::vector_size(LANES * sizeof(double))]] = double;

// Add products, lane by lane.
[[gnu::always_inline]] inline void add_product(const double* a, const double* b, Lanes& sums) {
    for (std::size_t lane = 0; lane < LANES; ++lane) {
        sums[lane] = std::fma(a[lane], b[lane], sums[lane]);
    }
}

using TileSums = std::array<std::array<Lanes, TILE_COLUMNS>, TILE_ROWS>;

inline double total(const Lanes& sums) { return (sums[0] + sums[2]) + (sums[1] + sums[3]); }

// Fill the sums of a tile over a block; compiled twice, see models/ensembles.hpp.
#if defined(__x86_64__)
[[gnu::target_clones("fma", "default")]]
#endif
inline void sum_tile(
    const std::array<const double*, TILE_ROWS>& a,
    const std::array<const double*, TILE_COLUMNS>& b,
    TileSums& tile
) {
    // By name: the compiler keeps no array in registers.
    Lanes s00{}, s01{}, s10{}, s11{}, s20{}, s21{}, s30{}, s31{};
    for (std::size_t k = 0; k < GRAM_BLOCK; k += LANES) {
        add_product(a[0] + k, b[0] + k, s00);
        add_product(a[0] + k, b[1] + k, s01);
        add_product(a[1] + k, b[0] + k, s10);
        add_product(a[1] + k, b[1] + k, s11);
        add_product(a[2] + k, b[0] + k, s20);
        add_product(a[2] + k, b[1] + k, s21);
        add_product(a[3] + k, b[0] + k, s30);
        add_product(a[3] + k, b[1] + k, s31);
    }
    tile = {{{s00, s01}, {s10, s11}, {s20, s21}, {s30, s31}}};
}

// Add the products of rows, which are `factors`, to the lower triangle of `sums` (m, m), by tiles.
//
// The sums of squares and products are where identification spends its time. BLAS takes twice as long for
// blocks of this shape, and its sums depend on the number of threads; these are the same on any of them.
inline void add_products(const Rows& rows, Records<const std::int64_t> factors, double* sums) {
    TileSums tile;
    for (std::size_t i = 0; i < factors.size; i += TILE_ROWS) {
        const std::array<const double*, TILE_ROWS> a{
            rows[factors[i]], rows[factors[i + 1]], rows[factors[i + 2]], rows[factors[i + 3]]
        };
        for (std::size_t j = 0; j < i + TILE_ROWS; j += TILE_COLUMNS) {
            sum_tile(a, {rows[factors[j]], rows[factors[j + 1]]}, tile);
            for (std::size_t row = 0; row < TILE_ROWS; ++row) {
                for (std::size_t column = 0; column < TILE_COLUMNS; ++column) {
                    sums[(i + row) * factors.size + j + column] += total(tile[row][column]);
                }
            }
        }
    }
}

// Add up the lower triangle of `sums` (m, m) of the rows that are `factors` (m,): those of a program, and the
// target after them. `rows` has room for a block; m is a multiple of TILE_ROWS.
inline void add_samples(
    Records<const InputVector> inputs,
    const double* target,
    Records<const Operation> operations,
    Records<const std::int64_t> factors,
    const Rows& rows,
    double* sums
) {
    const std::size_t target_row = BASE_ROWS + operations.size;
    for (std::size_t start = 0; start < inputs.size; start += GRAM_BLOCK) {
        const std::size_t count = std::min(GRAM_BLOCK, inputs.size - start);
        fill_rows(inputs.part(start, start + count), operations, rows);
        std::copy_n(target + start, count, rows[target_row]);
        for (std::size_t row = 0; row <= target_row; ++row) {
            std::fill(rows[row] + count, rows[row] + GRAM_BLOCK, 0.0);
        }
        add_products(rows, factors, sums);
    }
}

}  // namespace quadpi
