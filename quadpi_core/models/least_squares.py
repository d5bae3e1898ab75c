# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Least squares on Gram matrices, accumulated per flight in one pass without an N × p matrix, and Huber's."""

from __future__ import annotations

import operator
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import ModelError, one_line
from quadpi_core.frames import Array
from quadpi_core.models.regressors import BASE_ROWS, RegressorProgram

# Samples that a thread takes at a time; fixed, so that sums do not depend on the number of cores.
_PIECE = 10_000
# Numbers of 8 bytes in a cache line.
_CACHE_LINE = 8


@dataclass(frozen=True)
class Gram:
    """Sums over samples of regressors z (p,) and target y: all that least squares needs to know.

    The first regressor is the constant 1, so `moment[0]` is the sum of y.

    Attributes:
        matrix: (p, p) Σ z zᵀ.
        moment: (p,) Σ z y.
        square: Σ y².
        count: number of samples.
    """

    matrix: Array
    moment: Array
    square: float
    count: int

    def __add__(self, other: Gram) -> Gram:
        return Gram(*map(operator.add, vars(self).values(), vars(other).values()))

    def __sub__(self, other: Gram) -> Gram:
        return Gram(*map(operator.sub, vars(self).values(), vars(other).values()))

    @property
    def total_square(self) -> float:
        """Σ (y − ȳ)²."""
        return float(self.square - self.moment[0] ** 2 / self.count)

    def residual_square(self, active: list[int], coefficients: Array) -> float:
        """Σ (y − z_active · coefficients)², of any coefficients, also such fitted elsewhere."""
        explained = 2.0 * self.moment[active] - self.matrix[np.ix_(active, active)] @ coefficients
        return max(float(self.square - coefficients @ explained), 0.0)


def sum_grams(grams: Sequence[Gram]) -> Gram:
    """The Gram of all flights together."""
    return reduce(operator.add, grams)


@contextmanager
def identifiable(what: str) -> Iterator[None]:
    """Say what flights cannot tell where equations of a fit turn out to be singular.

    Raises:
        ModelError: in the place of numpy's error.
    """
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise ModelError(
            f"{what} cannot be identified from these flights, as the equations have no solution "
            f"({one_line(error)}): `quadpi info` tells of flights whose sensors disagree; else fly "
            "manoeuvres about every axis"
        ) from error


def fit_coefficients(gram: Gram, active: list[int]) -> tuple[Array, Array]:
    """Least squares on the active regressors by a Cholesky factor of the scaled Gram matrix.

    Returns:
        Coefficients (s,) and the whitening matrix W (s, s), lower triangular, with Wᵀ W = (ZᵀZ)⁻¹, so that
        the leverage of a regressor row z is |W z|².

    Raises:
        numpy.linalg.LinAlgError: if a regressor is zero on all samples, or they are linearly dependent.
    """
    from scipy.linalg import solve_triangular

    matrix = gram.matrix[np.ix_(active, active)]
    squares = np.diag(matrix)
    if not np.all(squares > 0.0):
        raise np.linalg.LinAlgError("a regressor is zero on all samples")
    scale = 1.0 / np.sqrt(squares)
    factor = np.linalg.cholesky(matrix * np.outer(scale, scale))
    whitening = solve_triangular(factor, np.diag(scale), lower=True)
    return whitening.T @ (whitening @ gram.moment[active]), whitening


def flight_grams(
    program: RegressorProgram, inputs: Array, target: Array, groups: npt.NDArray[np.int64]
) -> list[Gram]:
    """One Gram per flight, the work shared among the processor's cores.

    Args:
        program: its outputs are the regressors, the constant first.
        inputs: (N, 19).
        target: (N,).
        groups: (N,) flight number of each sample, 0 to F − 1.
    """
    pieces = []
    for flight in range(int(groups.max()) + 1):
        samples = np.flatnonzero(groups == flight)
        pieces += [(flight, samples[start : start + _PIECE]) for start in range(0, len(samples), _PIECE)]

    def gram_of(piece: tuple[int, npt.NDArray[np.intp]]) -> Gram:
        return _accumulate(program, inputs[piece[1]], target[piece[1]])

    totals: dict[int, Gram] = {}
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for (flight, _), gram in zip(pieces, threads.map(gram_of, pieces), strict=True):
            totals[flight] = totals[flight] + gram if flight in totals else gram
    return list(totals.values())


def _accumulate(program: RegressorProgram, inputs: Array, target: Array) -> Gram:
    """The Gram of some samples: the target goes along as one more regressor."""
    target_row = BASE_ROWS + len(program.operations)
    factors = np.append(program.outputs, target_row)
    size = len(factors)
    factors = np.pad(factors, (0, -size % compiled.TILE_ROWS), mode="edge")
    sums = np.zeros((len(factors), len(factors)))
    rows = _aligned_zeros(target_row + 1, compiled.GRAM_BLOCK)
    compiled.add_to_gram(
        np.ascontiguousarray(inputs), np.ascontiguousarray(target), program.operations, factors, rows, sums
    )
    lower = np.tril(sums[:size, :size])
    sums = lower + np.tril(lower, -1).T
    return Gram(sums[:-1, :-1], sums[:-1, -1], float(sums[-1, -1]), len(target))


def _aligned_zeros(rows: int, columns: int) -> Array:
    """Zeros (rows, columns) from the start of a cache line: vectors across two of them load at half speed."""
    buffer = np.zeros(rows * columns + _CACHE_LINE)
    skip = -(buffer.ctypes.data // buffer.itemsize) % _CACHE_LINE
    return buffer[skip : skip + rows * columns].reshape(rows, columns)


# Huber's k: residuals up to this many standard deviations have weight 1. Two in 1e9 normal residuals lie
# beyond, so without outliers the efficiency is 1 to eight digits.
TUNING = 6.0
# Standard deviation over median absolute residual, of a normal distribution.
_MAD = 1.4826
# Iterations end when predictions change by less than this share of the standard deviation.
_CHANGE, _ITERATIONS = 1e-3, 30


def huber(Z: Array, y: Array, coefficients: Array, whitening: Array) -> tuple[Array, Array]:
    """Coefficients (s,) and whitening (s, s) by iteratively reweighted least squares (Huber, 1964).

    Weights are 1 within TUNING deviations and fall as one over the residual beyond.

    Args:
        Z: regressors (N, s).
        y: target (N,).
        coefficients: (s,), by least squares; given back where no residual is beyond.
        whitening: see :func:`fit_coefficients`.

    Raises:
        ModelError: if the regressors are linearly dependent but for wild samples.
    """
    residual = y - Z @ coefficients
    for _ in range(_ITERATIONS):
        size = np.abs(residual)
        bound = TUNING * _MAD * float(np.median(size))
        if bound == 0.0 or not np.any(size > bound):
            break
        weights = bound / np.maximum(size, bound)
        weighted = Z * weights[:, np.newaxis]
        gram = Gram(weighted.T @ Z, weighted.T @ y, float((weights * y) @ y), len(y))
        try:
            coefficients, whitening = fit_coefficients(gram, list(range(Z.shape[1])))
        except np.linalg.LinAlgError as error:
            raise ModelError(
                f"the terms of the model differ in wild samples alone, with residuals up to {size.max():.3g}"
            ) from error
        before, residual = residual, y - Z @ coefficients
        if np.max(np.abs(residual - before)) < _CHANGE * bound / TUNING:
            break
    return coefficients, whitening


# Forward selection with orthogonalisation and backward elimination as in Klein and Morelli, *Aircraft
# System Identification*, section 5.4. The Gram matrix is factored by a partial Cholesky decomposition
# whose pivots are the selected regressors, so a step costs O(p) per regressor already chosen, regardless of
# the number of samples.

StopRule: TypeAlias = Literal["pse", "r2", "bic", "leave-one-flight-out"]
# A score of a set of regressors, to be made as small as possible.
_Score: TypeAlias = Callable[[list[int], float], float]

# Least increase of R² by a further term under the rule "r2".
R2_GROWTH = 0.005
# Least fall of the leave-one-flight-out error, relative, that counts as progress.
HELD_OUT_GAIN = 0.01
# Floor of the error on a flight left out, as a share of the target's variance: smaller ones count as equal.
HELD_OUT_FLOOR = 0.01
# Steps without progress after which the rules "bic" and "leave-one-flight-out" stop.
PATIENCE = 2


@dataclass(frozen=True)
class SelectionSettings:
    """How terms are chosen.

    Attributes:
        stop: predicted square error, growth of R², BIC, or error on flights left out in turn.
        max_terms: most terms beyond the fixed ones.
        f_enter, f_remove: partial F values that admit a term and that keep it.
        rank_tolerance: a candidate of whose squared norm less than this share is left after
            orthogonalisation is a combination of the others and is never admitted.
    """

    stop: StopRule = "leave-one-flight-out"
    max_terms: int = 10
    f_enter: float = 4.0
    f_remove: float = 4.0
    rank_tolerance: float = 1e-9


@dataclass(frozen=True)
class SelectionStep:
    """State after one step: what came and went, and how well the active set fits."""

    added: int | None
    removed: tuple[int, ...]
    active: tuple[int, ...]
    sse: float
    r2: float
    score: float


def select(
    grams: list[Gram],
    n_fixed: int,
    settings: SelectionSettings,
    names: list[str],
) -> tuple[list[int], list[SelectionStep]]:
    """Choose regressors for the flights whose Gram matrices are given.

    Args:
        grams: one per flight; the first `n_fixed` regressors are always in the model.
        n_fixed: number of fixed regressors, the bias included.
        settings: stop rule and limits.
        names: of the regressors, for messages.

    Returns:
        The chosen regressors in order of selection, and the log of all steps, the ones beyond the
        chosen set included.

    Raises:
        ModelError: if a fixed regressor is a combination of the others, or the rule needs more flights.
    """
    total = sum_grams(grams)
    score = _score(grams, total, settings.stop)
    basis = _OrthogonalBasis(total, settings.rank_tolerance)
    for k in range(n_fixed):
        if not basis.admissible()[k]:
            raise ModelError(
                f"regressor `{names[k]}` is constant or a combination of the other fixed ones on these "
                f"flights: they do not excite it"
            )
        basis.add(k)

    steps = [_step(basis, None, (), score)]
    seen = {frozenset(basis.active)}
    while len(basis.active) - n_fixed < settings.max_terms:
        added = _enter(basis, settings.f_enter)
        if added is None:
            break
        basis, removed = _eliminated(basis, n_fixed, settings.f_remove)
        if frozenset(basis.active) in seen:
            break
        seen.add(frozenset(basis.active))
        steps.append(_step(basis, added, removed, score))
        if _stalled(steps, settings.stop):
            break
    return list(_best(steps, settings.stop).active), steps


class _OrthogonalBasis:
    """All regressors with their part along the active ones removed, known by norms and correlations."""

    def __init__(self, gram: Gram, tolerance: float) -> None:
        self.gram, self._tolerance = gram, tolerance
        self.active: list[int] = []
        self._columns: list[Array] = []
        self._norm2, self._correlation = np.diag(gram.matrix).copy(), gram.moment.copy()
        self.sse = gram.square

    def admissible(self) -> npt.NDArray[np.bool_]:
        """True where a regressor is not a combination of the active ones."""
        remaining: npt.NDArray[np.bool_] = self._norm2 > self._tolerance * np.diag(self.gram.matrix)
        remaining[self.active] = False
        return remaining

    def add(self, k: int) -> None:
        """Orthogonalise every regressor with respect to regressor k."""
        column = self.gram.matrix[:, k].copy()
        for earlier in self._columns:
            column -= earlier * earlier[k]
        column /= np.sqrt(self._norm2[k])
        along = self._correlation[k] / np.sqrt(self._norm2[k])
        self._norm2 -= column**2
        self._correlation -= column * along
        # Rounding leaves an exact fit slightly above or below zero; scores take its logarithm.
        self.sse = max(self.sse - along**2, np.finfo(float).eps * self.gram.square)
        self._columns.append(column)
        self.active.append(k)

    def without(self, k: int) -> _OrthogonalBasis:
        """The basis but for regressor k: the factor is rebuilt, as later pivots were orthogonal to it."""
        rest = _OrthogonalBasis(self.gram, self._tolerance)
        for other in self.active:
            if other != k:
                rest.add(other)
        return rest

    def gains(self) -> Array:
        """Fall of the squared error that each admissible regressor would bring, −1 for the others."""
        gains = np.full(len(self._norm2), -1.0)
        ok = self.admissible()
        gains[ok] = self._correlation[ok] ** 2 / self._norm2[ok]
        return gains

    def partial_f(self) -> Array:
        """Partial F value of each active regressor."""
        coefficients, whitening = fit_coefficients(self.gram, self.active)
        variance = self.sse / max(self.gram.count - len(self.active), 1)
        return coefficients**2 / ((whitening**2).sum(axis=0) * variance)


def _enter(basis: _OrthogonalBasis, f_enter: float) -> int | None:
    gains = basis.gains()
    best = int(np.argmax(gains))
    freedom = basis.gram.count - len(basis.active) - 1
    remaining = basis.sse - gains[best]
    if gains[best] <= 0 or freedom < 1 or gains[best] * freedom < f_enter * remaining:
        return None
    basis.add(best)
    return best


def _eliminated(
    basis: _OrthogonalBasis, n_fixed: int, f_remove: float
) -> tuple[_OrthogonalBasis, tuple[int, ...]]:
    removed: list[int] = []
    while len(basis.active) > n_fixed + 1:
        partial_f = basis.partial_f()
        partial_f[:n_fixed] = np.inf
        weakest = int(np.argmin(partial_f))
        if partial_f[weakest] >= f_remove:
            break
        removed.append(basis.active[weakest])
        basis = basis.without(removed[-1])
    return basis, tuple(removed)


def _step(
    basis: _OrthogonalBasis, added: int | None, removed: tuple[int, ...], score: _Score
) -> SelectionStep:
    return SelectionStep(
        added=added,
        removed=removed,
        active=tuple(basis.active),
        sse=basis.sse,
        r2=1.0 - basis.sse / basis.gram.total_square,
        score=score(basis.active, basis.sse),
    )


def _score(grams: list[Gram], total: Gram, stop: StopRule) -> _Score:
    count = total.count
    if stop == "pse":
        # Predicted square error (Barron; Klein and Morelli Eq. 5.86): σ_max² is the variance of y.
        penalty = total.total_square / count**2
        return lambda active, sse: sse / count + penalty * len(active)
    if stop == "r2":
        return lambda _, sse: sse / total.total_square
    if stop == "bic":
        return lambda active, sse: count * np.log(sse / count) + len(active) * np.log(count)
    if stop == "leave-one-flight-out":
        if len(grams) < 2:
            raise ModelError(
                "the stop rule leave-one-flight-out needs two flights or more; pse, r2 and bic take one"
            )
        rests = [total - gram for gram in grams]
        floor = HELD_OUT_FLOOR * total.total_square / count
        return lambda active, _: _held_out_error(active, grams, rests, floor)
    raise ModelError(f"unknown stop rule {stop!r}; known: pse, r2, bic, leave-one-flight-out")


def _held_out_error(active: list[int], grams: list[Gram], rests: list[Gram], floor: float) -> float:
    """Mean over flights of the log mean-square error, plus floor, of each under coefficients of the others.

    The log weighs flights by relative error, so that the wildest flight does not decide alone; the floor
    keeps those that hardly excite the axis, and have but noise to show for any term, from deciding instead.
    """
    errors = []
    for gram, rest in zip(grams, rests, strict=True):
        try:
            coefficients, _ = fit_coefficients(rest, active)
        except np.linalg.LinAlgError:
            return np.inf
        errors.append(max(gram.residual_square(active, coefficients), 0.0) / gram.count + floor)
    return float(np.mean(np.log(errors)))


def _progress(step: SelectionStep, best: SelectionStep, stop: StopRule) -> bool:
    if stop == "r2":
        return best.score - step.score >= R2_GROWTH
    if stop == "leave-one-flight-out":
        return step.score < best.score - HELD_OUT_GAIN
    return step.score < best.score


def _best(steps: list[SelectionStep], stop: StopRule) -> SelectionStep:
    best = steps[0]
    for step in steps[1:]:
        if _progress(step, best, stop):
            best = step
    return best


def _stalled(steps: list[SelectionStep], stop: StopRule) -> bool:
    since_best = len(steps) - 1 - steps.index(_best(steps, stop))
    return since_best >= (1 if stop in {"pse", "r2"} else PATIENCE)
