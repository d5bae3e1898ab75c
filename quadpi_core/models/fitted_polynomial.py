# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted polynomials, evaluated in compiled code, one sample after the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np

from quadpi_core.config_schema import NotNegative, ReadBy, Within
from quadpi_core.core import compiled
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import StoredRule
from quadpi_core.models.model_kind import CompiledFitted, FittedAxis
from quadpi_core.models.regressors import BASE_ROWS, Regressor, RegressorProgram
from quadpi_core.records import Records

# Root mean square of a spread over training samples: √(1 + κ h + γ V²) is never below 1.
RmsSpread: TypeAlias = Annotated[float, Within(1.0)]

# One axis: number of terms, 0 where it is not held; κ and γ of its spread; root mean square of that.
_AXIS = np.dtype(
    [("size", np.int64), ("inflation", np.float64), ("growth", np.float64), ("rms_spread", np.float64)],
    align=True,
)
# One term: row of the program, and coefficient.
_TERM = np.dtype([("row", np.int64), ("coefficient", np.float64)], align=True)


@dataclass(frozen=True)
class PolynomialAxis(FittedAxis):
    """ŷ = Z(x) β with the regressors in order of selection, and what its intervals need.

    Attributes:
        regressors: s terms, the bias first, the fixed ones before the selected.
        coefficients: (s,), SI units.
        whitening: (s, s) lower triangular W with leverage h = |W z|².
        inflation, growth: of the spread, see :class:`.envelope.SpreadShape`.
        rule: gives the interval's factor on the spread.
        rms_spread: root mean square of the spread over the training samples, the unit of relative width.
    """

    regressors: tuple[Annotated[Regressor, ReadBy(Regressor.parse)], ...]
    coefficients: Array
    whitening: Array
    inflation: NotNegative
    growth: NotNegative
    rule: StoredRule
    rms_spread: RmsSpread

    def __post_init__(self) -> None:
        size = len(self.regressors)
        if self.coefficients.shape != (size,) or self.whitening.shape != (size, size):
            raise ValueError(f"shapes do not fit the {size} regressors")

    @property
    def terms(self) -> list[str]:
        """The regressors as text."""
        return [str(regressor) for regressor in self.regressors]


class _Packed(NamedTuple):
    """What the compiled core takes of the axes held: tables padded to the longest, and that to whole groups.

    Attributes:
        operations: of the program of all regressors; common products are computed once.
        axes: (6,) size, inflation, growth and rms_spread.
        terms: (6, s) row and coefficient.
        whitening: (6, s, s).
        rows: room for those of the program, of one sample.
    """

    operations: Records
    axes: Records
    terms: Records
    whitening: Array
    rows: Array


class FittedPolynomials(CompiledFitted):
    """The polynomials of a model."""

    method = "polynomial"
    axis_type = PolynomialAxis

    @cached_property
    def compiled(self) -> compiled.Polynomials:
        """See the base class."""
        together = compiled.TERMS_TOGETHER
        longest = -(-max(len(axis.regressors) for axis in self.axes.values()) // together) * together
        program = RegressorProgram.compile(r for own in self.axes.values() for r in own.regressors)
        axes = np.zeros(len(AXES), dtype=_AXIS)
        terms = np.zeros((len(AXES), longest), dtype=_TERM)
        whitening = np.zeros((len(AXES), longest, longest))
        start = 0
        for axis, own in self.axes.items():
            k, size = AXES.index(axis), len(own.regressors)
            axes[k] = size, own.inflation, own.growth, own.rms_spread
            terms["row"][k, :size] = program.outputs[start : start + size]
            terms["coefficient"][k, :size] = own.coefficients
            whitening[k, :size, :size] = np.tril(own.whitening)
            start += size
        rows = np.empty(BASE_ROWS + len(program.operations))
        return compiled.Polynomials(_Packed(program.operations, axes, terms, whitening, rows))
