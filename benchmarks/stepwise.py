# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Stepwise identification on Gram matrices, against the direct way and against one XᵀX of its regressors.

The direct way, one least-squares fit per candidate and step, is also the reference of the tests.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from benchmarks import Result, interleaved_seconds
from benchmarks.synthetic_inputs import planted_target, smooth_inputs
from quadpi_core.frames import Array
from quadpi_core.models.kinds.polynomial import TermSearch
from quadpi_core.models.least_squares import SelectionSettings
from quadpi_core.models.regressors import RegressorProgram, load_pools

NAMES = ("stepwise_vs_direct", "stepwise_vs_gram")

SAMPLES = 100_000
PLANTED_TERMS = 16
# The direct way tries one in this many candidates of a step, and its time is scaled up.
ONE_IN = 10
# The threads of the direct way's BLAS stay busy for a while after their work is done.
REST_S = 0.1


def run() -> list[Result]:
    pool = load_pools("hdbeetle")["Fx"]
    inputs = smooth_inputs(SAMPLES, seed=1)
    matrix = RegressorProgram.compile(dict.fromkeys(pool.fixed + pool.candidates)).evaluate(inputs)
    target = planted_target(matrix, len(pool.fixed), PLANTED_TERMS, seed=1)

    def fit() -> TermSearch:
        search = TermSearch(pool, SelectionSettings("pse"), inputs, target, np.zeros(len(target), np.int64))
        search.by_residuals()
        return search

    return [against_direct(fit, len(pool.candidates), matrix, target), against_gram(fit, matrix)]


def against_gram(fit: Callable[[], TermSearch], matrix: Array) -> Result:
    """A whole identification, from inputs to intervals, beside one XᵀX of the finished regressors."""
    functions = (fit, lambda: matrix.T @ matrix)
    fitting, gram = interleaved_seconds(functions, repetitions=9).T
    samples, size = matrix.shape
    baseline = f"XᵀX of the finished {samples} x {size} matrix by numpy: {np.median(gram):.3f} s"
    return Result(
        "stepwise_vs_gram", float(np.median(fitting / gram)), "times", baseline, goal=2.0, at_most=True
    )


def against_direct(
    fit: Callable[[], TermSearch], candidates_of_pool: int, matrix: Array, target: Array
) -> Result:
    """A whole identification, beside the direct way on the same steps.

    Raises:
        RuntimeError: if the direct way finds a better term.
    """
    columns, steps = unit_columns(matrix), fit().steps
    fast_seconds, direct_seconds = [], 0.0
    for before, after in pairwise(steps):
        time.sleep(REST_S)
        start = time.perf_counter()
        fit()
        fast_seconds.append(time.perf_counter() - start)

        active = list(before.active)
        candidates = [k for k in range(matrix.shape[1]) if k not in active]
        assert after.added is not None
        tried = sorted({*candidates[::ONE_IN], after.added})
        start = time.perf_counter()
        errors = candidate_errors(columns, target, active, tried)
        direct_seconds += (time.perf_counter() - start) * len(candidates) / len(tried)
        if min(errors, key=errors.__getitem__) != after.added:
            raise RuntimeError(f"step {len(active)}: the direct way finds a better term")

    fast = float(np.median(fast_seconds))
    baseline = (
        f"numpy lstsq per candidate, {len(steps) - 1} steps of {candidates_of_pool} candidates, "
        f"{SAMPLES} samples: {direct_seconds:.0f} s, scaled from 1 in {ONE_IN} candidates; ours {fast:.3f} s"
    )
    return Result("stepwise_vs_direct", direct_seconds / fast, "times faster", baseline, goal=300.0)


def unit_columns(regressors: Array) -> Array:
    """Regressors (N, p) scaled to unit norm; beside (rad/s)³ least squares takes 1 for rounding noise."""
    scaled: Array = regressors / np.linalg.norm(regressors, axis=0)
    return scaled


def squared_error(regressors: Array, target: Array) -> float:
    """Sum of squared residuals of a least-squares fit on regressors (N, s)."""
    coefficients = np.linalg.lstsq(regressors, target, rcond=None)[0]
    residual = target - regressors @ coefficients
    return float(residual @ residual)


def direct_stepwise(
    regressors: Array,
    target: Array,
    n_fixed: int,
    max_terms: int,
    f_enter: float = 4.0,
    f_remove: float = 4.0,
) -> list[int]:
    """Select columns of `regressors` (N, p), one least-squares fit per candidate and step, by PSE."""
    regressors = unit_columns(regressors)
    count = len(regressors)
    variance = float(np.var(target))

    def pse(columns: list[int], sse: float) -> float:
        return sse / count + variance * len(columns) / count

    active = list(range(n_fixed))
    sse = squared_error(regressors[:, active], target)
    best, best_pse = list(active), pse(active, sse)
    while len(active) - n_fixed < max_terms:
        errors = candidate_errors(regressors, target, active)
        entering = min(errors, key=errors.__getitem__)
        if (sse - errors[entering]) * (count - len(active) - 1) < f_enter * errors[entering]:
            break
        active.append(entering)
        sse = errors[entering]
        while len(active) > n_fixed + 1:
            without = {
                k: squared_error(regressors[:, [a for a in active if a != k]], target)
                for k in active[n_fixed:]
            }
            weakest = min(without, key=without.__getitem__)
            if (without[weakest] - sse) * (count - len(active)) >= f_remove * sse:
                break
            active.remove(weakest)
            sse = without[weakest]
        if pse(active, sse) >= best_pse:
            break
        best, best_pse = list(active), pse(active, sse)
    return best


def candidate_errors(
    regressors: Array, target: Array, active: list[int], candidates: list[int] | None = None
) -> dict[int, float]:
    """Squared error with each candidate (all that are not active, if None) added to the active columns."""
    if candidates is None:
        candidates = [k for k in range(regressors.shape[1]) if k not in active]
    return {k: squared_error(regressors[:, [*active, k]], target) for k in candidates}
