# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bayesian evidence for sets of effects, from Gram matrices alone.

For columns X with prior N(0, 1) on every coefficient and white noise of unit variance, the evidence of a
residual r is, up to a constant, ln p = −½ (r·r − bᵀA⁻¹b) − ½ ln det A with A = XᵀX + 1 and b = Xᵀr. The
tolerances of the simulation are part of every set, so that an effect has to explain what no coefficient
within its tolerance can. The law of an effect may be wrong, too: with the effect, a set contains columns for
the error of its form, in proportion to its size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array

# Prior precision of the form columns of an effect of size zero, whose form cannot differ.
_PRECISE = 1e12
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Block:
    """The columns of one candidate.

    Attributes:
        parameters: indices of its k parameter columns.
        form: indices of the columns for the error of its form, made for an effect of the size `formed_at`.
        formed_at: length of the coefficients that the form columns are in proportion to.
        offset: index of the column that its linearisation adds to the residual; none for a linear effect.
        at: (k,) point that it is linearised at, in prior standard deviations from their mean.
        lowest, highest: (k,) bounds of the parameters, in prior standard deviations.
        cost: evidence [nat] that the candidate loses for what is fitted to each flight beside its columns.
    """

    parameters: Indices
    form: Indices
    formed_at: float
    offset: int | None
    at: Array
    lowest: Array
    highest: Array
    cost: float = 0.0


class Fit(NamedTuple):
    """Fit of a set of effects.

    Attributes:
        log_evidence: log evidence [nat] relative to other fits on the same Gram matrix.
        columns: (c,) indices of the fitted columns.
        coefficients: (c,) their posterior mean.
        covariance: (c, c) their posterior covariance.
        left: (K,) weight of each column of the Gram matrix in the residual after the fit.
    """

    log_evidence: float
    columns: Indices
    coefficients: Array
    covariance: Array
    left: Array

    def of(self, wanted: Indices) -> Array:
        """Coefficients of some columns; 0 for those that a bound excluded."""
        return self._at(wanted, self.coefficients)

    def deviation(self, wanted: Indices) -> Array:
        """Posterior standard deviation of some columns; 0 for those that a bound excluded."""
        return self._at(wanted, np.sqrt(np.diag(self.covariance)))

    def _at(self, wanted: Indices, values: Array) -> Array:
        found: Array = (self.columns == wanted[:, None]) @ values
        return found


def fit(gram: Array, tolerances: Indices, blocks: Sequence[Block]) -> Fit | None:
    """Fit tolerances and a set of effects; None where bounds exclude every parameter of an effect.

    A parameter whose posterior mean violates its bound is set to zero, its nearest bound, and the rest are
    fitted again.

    Args:
        gram: (K, K); column 0 is the residual.
        tolerances: indices of the columns of the simulation's tolerances.
        blocks: columns of each effect.
    """
    residual = residual_weights(len(gram), blocks)
    out: set[int] = set()
    form: list[Array] | None = None
    exact: Fit | None = None
    while True:
        kept = [[i for i in block.parameters if i not in out] for block in blocks]
        if any(len(own) == 0 for own in kept):
            # If the form columns would flip the sign of the effect, fall back to the fit without them.
            return exact
        parts, precisions = [tolerances], [np.ones(len(tolerances))]
        for place, (own, block) in enumerate(zip(kept, blocks, strict=True)):
            parts.append(np.asarray(own))
            precisions.append(np.ones(len(own)))
            if form is not None:
                parts.append(block.form)
                precisions.append(form[place])
        columns = np.concatenate(parts).astype(np.intp)
        found = _evidence(gram, columns, residual, np.concatenate(precisions))
        found = found._replace(log_evidence=found.log_evidence - sum(block.cost for block in blocks))
        beyond = _beyond_bounds(found, blocks) - out
        out |= beyond
        if beyond:
            continue
        if not any(len(block.form) for block in blocks):
            return found
        if exact is not None:
            # A law may be exact: form columns that are not needed must not cost it evidence.
            return found if found.log_evidence > exact.log_evidence else exact
        exact = found
        # The sizes of the effects, now known, scale by how much their forms may differ.
        form = [np.full(len(block.form), _form_precision(found, block)) for block in blocks]


def evidence_at(gram: Array, tolerances: Indices, blocks: Sequence[Block]) -> float:
    """Log evidence [nat] of a set with the parameters that are not linear at their points, where it is exact.

    Far from its point a linearisation may promise what it cannot keep. Values at different points of the same
    set can be compared with each other, not with :func:`fit`.

    Args:
        gram: (K, K); column 0 is the residual.
        tolerances: indices of the columns of the simulation's tolerances.
        blocks: columns of each effect.
    """
    residual = residual_weights(len(gram), blocks)
    columns, cost = [tolerances], 0.0
    for block in blocks:
        cost += block.cost
        if block.offset is None:
            columns.append(block.parameters)
        else:
            residual[block.parameters] -= block.at
            cost += 0.5 * float(block.at @ block.at)
    free = np.concatenate(columns).astype(np.intp)
    return _evidence(gram, free, residual, np.ones(len(free))).log_evidence - cost


def refit(gram: Array, found: Fit, blocks: Sequence[Block]) -> Fit:
    """Fit the same columns to another Gram matrix, without bounds; those of a fit without form columns.

    Args:
        gram: (K, K); column 0 is the residual.
        found: fit whose columns are fitted.
        blocks: columns of each effect.
    """
    return _evidence(gram, found.columns, residual_weights(len(gram), blocks), np.ones(len(found.columns)))


def fit_forms(
    gram: Array, tolerances: Indices, blocks: Sequence[Block], fixed: Fit, formed: Sequence[Block]
) -> Fit:
    """Fit tolerances and the forms of some effects, with the parameters of all effects fixed.

    Args:
        gram: (K, K); column 0 is the residual.
        tolerances: indices of the columns of the simulation's tolerances.
        blocks: columns of each effect.
        fixed: fit that the parameters are taken from.
        formed: blocks whose forms are fitted.
    """
    residual = residual_weights(len(gram), blocks)
    for block in blocks:
        residual[block.parameters] -= fixed.of(block.parameters)
    columns = np.concatenate([tolerances, *(block.form for block in formed)]).astype(np.intp)
    precisions = np.concatenate((np.ones(len(tolerances)), form_precisions(fixed, formed)))
    return _evidence(gram, columns, residual, precisions)


def with_forms(gram: Array, found: Fit, blocks: Sequence[Block]) -> Fit:
    """The fit of the same columns beside those of the forms of all blocks, whether they are needed or not.

    Args:
        gram: (K, K); column 0 is the residual.
        found: fit that columns and the sizes of the effects are taken from.
        blocks: columns of each of its effects.
    """
    known = found.columns[~np.isin(found.columns, np.concatenate([block.form for block in blocks]))]
    columns = np.concatenate((known, *(block.form for block in blocks))).astype(np.intp)
    precisions = np.concatenate((np.ones(len(known)), form_precisions(found, blocks)))
    return _evidence(gram, columns, residual_weights(len(gram), blocks), precisions)


def form_precisions(found: Fit, formed: Sequence[Block]) -> Array:
    """Prior precision of the form columns of blocks, in a row, for effects of the sizes of a fit."""
    return np.concatenate(
        [np.empty(0), *(np.full(len(block.form), _form_precision(found, block)) for block in formed)]
    )


def residual_weights(width: int, blocks: Sequence[Block]) -> Array:
    """Weight (width,) of each column in the residual beside the points that effects are linearised at."""
    weights = np.zeros(width)
    weights[0] = 1.0
    for block in blocks:
        if block.offset is not None:
            weights[block.offset] = 1.0
    return weights


def _form_precision(found: Fit, block: Block) -> float:
    size = float(np.linalg.norm(found.of(block.parameters)))
    return float(min((block.formed_at / max(size, 1e-9)) ** 2, _PRECISE))


def _evidence(gram: Array, columns: Indices, residual: Array, precisions: Array) -> Fit:
    matrix = gram[np.ix_(columns, columns)] + np.diag(precisions)
    lower = np.linalg.cholesky(matrix)
    projected = gram[columns] @ residual
    half = np.linalg.solve(lower, projected)
    coefficients = np.linalg.solve(lower.T, half)
    inverse = np.linalg.solve(lower, np.eye(len(columns)))
    log_evidence = -0.5 * float(residual @ gram @ residual - half @ half)
    log_evidence -= float(np.log(np.diag(lower)).sum() - 0.5 * np.log(precisions).sum())
    left = residual.copy()
    left[columns] -= coefficients
    return Fit(log_evidence, columns, coefficients, inverse.T @ inverse, left)


def _beyond_bounds(found: Fit, blocks: Sequence[Block]) -> set[int]:
    beyond: set[int] = set()
    for block in blocks:
        values = found.of(block.parameters)
        outside = (values < block.lowest) | (values > block.highest)
        beyond |= {int(i) for i in block.parameters[outside] if i in found.columns}
    return beyond
