# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the whole result of a search: the axis that is told, and sentences that are true."""

from __future__ import annotations

import numpy as np

from quadpi_core.discrepancy.result_verdicts import (
    judge_closed,
    judge_coefficients,
    judge_coefficients_together,
    judge_colour,
    judge_rollouts,
    judge_unexplained,
    unexplained_axis,
    unexplained_share,
)


def test_the_axis_that_most_is_left_of_is_told():
    """A sixth of one loud axis has no name, which is little beside all that is explained."""
    left, named, rows = np.zeros(6), np.full(6, 1000.0), 100
    left[4], named[4] = 300.0, 300.0
    share = unexplained_share(left, named, rows)
    assert share == 0.5
    assert unexplained_axis(left, named, rows) == 4
    assert (
        judge_unexplained(share, "My").sentence
        == "50 % of what can be predicted of My has no name, 5 % allowed"
    )
    assert unexplained_axis(np.zeros(6), named, rows) is None
    assert unexplained_share(np.zeros(6), named, rows) == 0.0


def test_sentences_of_tests_that_hold_are_true():
    held = judge_coefficients({"thrust": 8.0}, {"thrust": 0.02})
    assert held.passed
    assert held.sentence.endswith("but explains no more than 2 % by that")
    assert judge_coefficients({}, {}).sentence == "no coefficient is wrong by more than 5 of its tolerances"
    quiet = judge_colour(np.full(6, 20.0), np.zeros(6), tuple("abcdef"))
    assert quiet.passed
    assert quiet.sentence.startswith("no axis has more slow noise")
    assert judge_rollouts({"rates": 2.0}, {"rates": 1.0}).sentence.startswith(
        "roll-outs of flights left out do not get worse"
    )
    assert judge_closed(-4.35).sentence == "the gap of flights left out grows by 435 %"


def test_coefficients_together_are_judged_as_one_alone():
    assert judge_coefficients_together(24.9, 1, 1.0).passed
    assert not judge_coefficients_together(25.1, 1, 1.0).passed
    # Of thirty, each may be wrong by 1.67 tolerances.
    assert judge_coefficients_together(30 * 1.66**2, 30, 1.0).passed
    far = judge_coefficients_together(30 * 1.68**2, 30, 1.0)
    assert not far.passed
    assert far.sentence.endswith("wrong by 1.7 of their tolerances, root mean square, 1.7 allowed")
    assert judge_coefficients_together(0.0, 30, 0.0).sentence == "no coefficient has to be wrong"
    little = judge_coefficients_together(270.0, 30, 0.02)
    assert little.passed
    assert little.sentence.endswith("but explain no more than 2 % by that")
    assert judge_coefficients_together(0.0, 0, 0.0).passed
