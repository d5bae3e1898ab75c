# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Stepwise identification on Gram matrices against one least-squares fit per candidate and step."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np

from benchmarks import Result
from benchmarks.direct_stepwise import candidate_errors, unit_columns
from benchmarks.synthetic_inputs import planted_target, smooth_inputs
from quadpi_core.models.candidate_pool import load_pools
from quadpi_core.models.kinds.polynomial import StepwisePolynomial
from quadpi_core.models.regressors import RegressorProgram

NAMES = ("stepwise_vs_direct",)

SAMPLES = 100_000
PLANTED_TERMS = 16
# The direct way tries one in this many candidates of a step, and its time is scaled up.
ONE_IN = 10
# The threads of the direct way's BLAS stay busy for a while after their work is done.
REST_S = 0.1


def run() -> list[Result]:
    pool = load_pools("hdbeetle")["Fx"]
    inputs = smooth_inputs(SAMPLES, seed=1)
    regressors = list(dict.fromkeys(pool.fixed + pool.candidates))
    matrix = RegressorProgram.compile(regressors).evaluate(inputs)
    columns = unit_columns(matrix)
    target = planted_target(matrix, len(pool.fixed), PLANTED_TERMS, seed=1)
    model = StepwisePolynomial.paper(pool).fit(inputs, target)
    steps = model.steps_

    fast_seconds, direct_seconds = [], 0.0
    for before, after in pairwise(steps):
        time.sleep(REST_S)
        start = time.perf_counter()
        model.fit(inputs, target)
        fast_seconds.append(time.perf_counter() - start)

        active = list(before.active)
        candidates = [k for k in range(len(regressors)) if k not in active]
        assert after.added is not None
        tried = sorted({*candidates[::ONE_IN], after.added})
        start = time.perf_counter()
        errors = candidate_errors(columns, target, active, tried)
        direct_seconds += (time.perf_counter() - start) * len(candidates) / len(tried)
        if min(errors, key=errors.__getitem__) != after.added:
            raise RuntimeError(f"step {len(active)}: the direct way finds a better term")

    fast = float(np.median(fast_seconds))
    baseline = (
        f"numpy lstsq per candidate, {len(steps) - 1} steps of {len(pool.candidates)} candidates, "
        f"{SAMPLES} samples: {direct_seconds:.0f} s, scaled from 1 in {ONE_IN} candidates; ours {fast:.3f} s"
    )
    return [Result(NAMES[0], direct_seconds / fast, "times faster", baseline, goal=300.0)]
