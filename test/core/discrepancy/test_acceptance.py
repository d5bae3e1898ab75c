# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a candidate has to gain, and what it may enlarge on flights left out."""

from __future__ import annotations

import numpy as np

from quadpi_core.discrepancy.acceptance import LEAST_EVIDENCE, evidence_threshold, judge_left_out

SQUARES = np.full(6, 100.0)


def first_axis(value, others=0.0):
    return np.array([value, *[others] * 5])


def test_what_an_effect_takes_from_one_axis_may_return_in_another():
    """Coefficients settle elsewhere beside a true effect."""
    after = SQUARES + first_axis(200.0, -80.0)
    assert judge_left_out(SQUARES, after, 10).passed == (200.0 <= 0.5 * (100.0 + 200.0))
    assert judge_left_out(SQUARES, SQUARES + first_axis(140.0, -80.0), 10).passed


def test_candidates_without_draws_need_the_least_evidence():
    """Of wind alone, which is not linear, there are none."""
    assert evidence_threshold(np.full(9, -np.inf)) == LEAST_EVIDENCE.value
    assert evidence_threshold(np.full(9, 50.0)) == 50.0
