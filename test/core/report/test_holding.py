# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Of which coverage a sentence may say that intervals hold."""

from __future__ import annotations

from dataclasses import replace

import pytest

from quadpi_core.evaluation.evaluation_result import Comparison
from quadpi_core.paper.validation_result import (
    AxisValidation,
    ModelValidation,
    NoiseLevels,
    Validation,
    Variation,
)
from quadpi_core.report import comparison_page
from quadpi_core.report.evaluation_sections import verdict
from quadpi_core.report.holding import Coverage, Holding, in_cells, joint
from quadpi_core.report.validation_page import _header


@pytest.mark.parametrize(
    ("estimate", "interval", "expected"),
    [
        (0.97, (0.95, 0.99), Holding.HOLDS),
        (0.931, (0.90, 0.96), Holding.HOLDS),
        # Within two points: beyond chance, but nobody would decide otherwise.
        (0.94, (0.935, 0.945), Holding.HOLDS),
        (0.929, (0.90, 0.96), Holding.NOT_SHOWN),
        (0.999, (0.89, 1.0), Holding.NOT_SHOWN),
        (0.834, (0.619, 0.955), Holding.NOT_SHOWN),
        (0.92, (0.90, 0.945), Holding.FAILS),
        (0.60, (0.30, 0.94), Holding.FAILS),
        (0.99, None, Holding.NOT_SHOWN),
    ],
)
def test_what_may_be_said_of_a_coverage(estimate, interval, expected):
    assert Coverage("Fx", estimate, interval).holding(0.95) is expected


def test_of_several_the_worst_counts_and_the_lowest_comes_first():
    good, unknown = Coverage("Fx", 0.96, (0.95, 0.97)), Coverage("Fy", 0.8, (0.6, 0.96))
    bad, worse = Coverage("Fz", 0.7, (0.6, 0.8)), Coverage("Mx", 0.5, (0.4, 0.6))
    assert joint([good], 0.95) == (Holding.HOLDS, [good])
    assert joint([good, unknown], 0.95) == (Holding.NOT_SHOWN, [unknown])
    assert joint([bad, good, unknown, worse], 0.95) == (Holding.FAILS, [worse, bad])


def test_cells_are_counted_and_what_does_not_hold_is_named():
    cells = {"a": [Coverage("m Fx", 0.96, (0.95, 0.97)), Coverage("m Fy", 0.834, (0.619, 0.955))]}
    assert in_cells(cells, 0.95) == (
        "hold in 1 of 2 on a; are not shown to hold in 1 on a (m Fy 83.4 %, 61.9 % to 95.5 %)"
    )


def test_headlines_of_page_and_comparison_go_by_the_same_rule(case, with_coverage):
    few = with_coverage(case.evaluation.groups["known"], "Mz", 0.834, [0.619, 0.955])
    evaluation = replace(case.evaluation, groups={"few": few})
    assert verdict(evaluation, []) == (
        "95 % prediction intervals are not shown to hold on few (1 of 6 axes; Mz 83.4 %, 61.9 % to 95.5 %)."
    )
    compared = Comparison("0", "v", 0.95, False, {"few": []}, None, {"m": evaluation})
    assert comparison_page.verdict(compared) == (
        "95\u00a0% prediction intervals hold in 5 of 6 on few; are not shown to hold in 1 on few "
        "(m Mz 83.4 %, 61.9 % to 95.5 %) (axes of all models)."
    )


@pytest.mark.parametrize(
    ("spread", "said"),
    [
        (0.001, "do not hold in 1 on the measurement variation (m Fx 90.0 %, 89.9 % to 90.1 %)"),
        (0.1, "are not shown to hold in 1 on the measurement variation (m Fx 90.0 %, 82.8 % to 97.2 %)"),
        (None, "m Fx 90.0 %, its precision unknown"),
    ],
)
def test_headline_of_a_validation_goes_by_it_too(spread, said):
    held = Variation(picp=0.99, picp_sd=0.001, mpiw=1.0, range=1.0, nmpiw=1.0, nmpiw_training=1.0)
    measured = replace(held, picp=0.9, picp_sd=spread)
    model = ModelValidation(
        "m", "polynomial", "default", {"Fx": AxisValidation(None, held, measured, held)}, {}
    )
    noise = NoiseLevels(*[0.1] * 5)
    result = Validation("0", "v", 0.95, 1, 10, noise, 30.0, {}, {"m": model}, None)
    page = _header(result)
    assert "95\u00a0% intervals hold in 1 of 1 on the model variation and 0 of 1 on" in page
    assert said in page
