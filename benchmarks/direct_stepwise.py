# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Stepwise regression done the obvious way, as the baseline and the reference for the fast one."""

from __future__ import annotations

import numpy as np

from quadpi_core.frames import Array


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
