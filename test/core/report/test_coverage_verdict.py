# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Of which coverage a sentence may say that intervals hold."""

from __future__ import annotations

from dataclasses import replace

import pytest

from quadpi_core.evaluation.evaluation_result import Comparison
from quadpi_core.report.comparison_page import comparison_verdict
from quadpi_core.report.evaluation_figures import Coverage, Holding, count_verdicts, joint_verdict
from quadpi_core.report.evaluation_page import evaluation_verdict


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
    assert joint_verdict([good], 0.95) == (Holding.HOLDS, [good])
    assert joint_verdict([good, unknown], 0.95) == (Holding.NOT_SHOWN, [unknown])
    assert joint_verdict([bad, good, unknown, worse], 0.95) == (Holding.FAILS, [worse, bad])


def test_cells_are_counted_and_what_does_not_hold_is_named():
    cells = {"a": [Coverage("m Fx", 0.96, (0.95, 0.97)), Coverage("m Fy", 0.834, (0.619, 0.955))]}
    assert count_verdicts(cells, 0.95) == (
        "hold in 1 of 2 on a; are not shown to hold in 1 on a "
        "(m Fy 83.4 %, 95 % confidence interval 61.9 % to 95.5 %)"
    )


def test_headlines_of_page_and_comparison_go_by_the_same_rule(case, with_coverage):
    few = with_coverage(case.evaluation.groups["known"], "Mz", 0.834, [0.619, 0.955])
    evaluation = replace(case.evaluation, groups={"few": few})
    assert evaluation_verdict(evaluation) == (
        "95\u00a0% prediction intervals are not shown to hold on few "
        "(in sample; 1 of 6 axes; Mz 83.4 %, 95 % confidence interval 61.9 % to 95.5 %)."
    )
    compared = Comparison("0", "v", 0.95, False, {"few": []}, {"m": evaluation})
    assert comparison_verdict(compared) == (
        "Over the axes of all models, 95\u00a0% prediction intervals hold in 5 of 6 on few; are not shown to "
        "hold in 1 on few (m Mz 83.4 %, 95 % confidence interval 61.9 % to 95.5 %)."
    )
