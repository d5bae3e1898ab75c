# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A whole stepwise identification, from inputs to intervals, against one XᵀX of its regressors."""

from __future__ import annotations

import numpy as np

from benchmarks import Result, interleaved_seconds
from benchmarks.synthetic_inputs import planted_target, smooth_inputs
from quadpi_core.models.candidate_pool import load_pools
from quadpi_core.models.kinds.polynomial import StepwisePolynomial
from quadpi_core.models.regressors import RegressorProgram

NAMES = ("stepwise_vs_gram",)

SAMPLES = 100_000
PLANTED_TERMS = 16


def run() -> list[Result]:
    pool = load_pools("hdbeetle")["Fx"]
    inputs = smooth_inputs(SAMPLES, seed=1)
    matrix = RegressorProgram.compile(dict.fromkeys(pool.fixed + pool.candidates)).evaluate(inputs)
    target = planted_target(matrix, len(pool.fixed), PLANTED_TERMS, seed=1)
    model = StepwisePolynomial.paper(pool)
    seconds = interleaved_seconds(
        [lambda: model.fit(inputs, target), lambda: matrix.T @ matrix], repetitions=9
    )
    fit, gram = seconds.T
    samples, size = matrix.shape
    baseline = f"XᵀX of the finished {samples} x {size} matrix by numpy: {np.median(gram):.3f} s"
    return [Result(NAMES[0], float(np.median(fit / gram)), "times", baseline, goal=2.0, at_most=True)]
