// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Sums of products that are rounded once, on the processor at hand.
//
// Every x86-64 processor since 2013 has instructions for std::fma, but a build for all of them may not use
// them. Functions with this attribute are compiled twice, and the loader takes the one that the processor can
// run. Both give the same bits: without such instructions, std::fma is a function of the C library.
#pragma once

#include <cmath>

#if defined(__x86_64__)
#define QUADPI_FUSED [[gnu::target_clones("fma", "default")]]
#else
#define QUADPI_FUSED
#endif
