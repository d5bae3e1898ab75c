# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Every threshold decides where it says, and every candidate of a search has a reason."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.discrepancy import acceptance
from quadpi_core.discrepancy.acceptance import (
    ACCEPTANCE_TESTS,
    THRESHOLDS,
    evidence_beside,
    evidence_threshold,
    judge_evidence,
    judge_left_out,
    judge_loudness,
    judge_size,
    judge_unexplained,
    predictable,
    rival_margin,
    unexplained_share,
)

SQUARES = np.full(6, 100.0)


def beside(gain, *, energy=1e6, law=False, beside_law=False, scales=False):
    needed = evidence_beside(energy, law=law, beside_law=beside_law, scales=scales)
    return judge_evidence(gain, needed).passed


def first_axis(value, others=0.0):
    return np.array([value, *[others] * 5])


# What a value in the unit of a threshold leads to, and where that turns over. The values are those of the
# thresholds, so that neither changes alone.
EXAMINED = {
    "FALSE_ALARMS": (
        0.01,
        lambda x: evidence_threshold(np.where(np.arange(1e4) < 1e4 * x, 99.0, 6.0)) > 50.0,
    ),
    "LEAST_EVIDENCE": (5.0, lambda x: judge_evidence(x, evidence_threshold(np.zeros(9))).passed),
    "FURTHER_SHARE": (0.05, lambda x: beside(1000.0 * x, energy=1000.0)),
    "FURTHER_LEAST": (20.0, lambda x: beside(x, energy=0.0) and beside(x, scales=True)),
    "FURTHER_NUMBER": (100.0, beside),
    "FURTHER_LAW": (200.0, lambda x: beside(x, law=True)),
    "BESIDE_LAW": (350.0, lambda x: beside(x, beside_law=True) and beside(x, law=True, beside_law=True)),
    "SMALLEST": (0.13, lambda x: judge_size({"large": 1.0, "small": x}).passed),
    "LOUDNESS": (0.1, lambda x: judge_loudness(x).passed),
    "GROWTH": (0.5, lambda x: judge_left_out(SQUARES, SQUARES + first_axis(100.0 * x), 10).passed),
    "FEW_FLIGHTS": (4.0, lambda x: judge_left_out(SQUARES, 9.0 * SQUARES, x).passed),
    "NAMED_ALONE": (4.6, lambda x: x < rival_margin(0.0)),
    "ALIKE": (0.1, lambda x: 1000.0 * x < rival_margin(1000.0)),
    "PREDICTABLE": (0.3, lambda x: predictable(first_axis(100.0 * x), 100).any()),
    "LOUD_AXIS": (0.8, lambda x: unexplained_share(first_axis(100.0 * x), first_axis(9.0, 1e6), 100) > 0.5),
    "PART_OF_AXIS": (0.2, lambda x: unexplained_share(first_axis(1e3 * x), first_axis(1e3, 1e9), 1) > 0.1),
    "UNEXPLAINED": (0.05, lambda x: judge_unexplained(x).passed),
}


@pytest.mark.parametrize("name", EXAMINED)
def test_a_threshold_decides_at_its_value(name):
    value, decision = EXAMINED[name]
    assert decision(0.99 * value) != decision(1.01 * value)
    assert getattr(acceptance, name).value == value


def test_every_threshold_is_examined_and_says_why():
    assert [getattr(acceptance, name) for name in EXAMINED] == list(THRESHOLDS)
    for threshold in THRESHOLDS:
        assert all((threshold.name, threshold.unit, threshold.reason, threshold.data))
    assert len({threshold.name for threshold in THRESHOLDS}) == len(THRESHOLDS)


def test_what_an_effect_takes_from_one_axis_may_return_in_another():
    """Coefficients settle elsewhere beside a true effect."""
    after = SQUARES + first_axis(200.0, -80.0)
    assert judge_left_out(SQUARES, after, 10).passed == (200.0 <= 0.5 * (100.0 + 200.0))
    assert judge_left_out(SQUARES, SQUARES + first_axis(140.0, -80.0), 10).passed


def test_a_search_gives_a_reason_for_every_candidate(found):
    judgements = found.discovery.found.judgements
    accepted = [own for own in judgements if own.accepted]
    assert [own.effect for own in accepted] == [effect.name for effect in found.discovery.effects]
    names = [test.name for test in ACCEPTANCE_TESTS]
    for own in judgements:
        tests = [verdict.test for verdict in own.verdicts]
        assert tests == names[: len(tests)]
        assert own.accepted == (len(tests) == len(names))
        assert all(verdict.passed for verdict in own.verdicts[:-1])
        assert all(verdict.sentence for verdict in own.verdicts)
    assert all(own.reason.test == "evidence" for own in accepted)
    assert not any(own.reason.passed for own in judgements if not own.accepted)
    rejected = [own for own in judgements if own.beside == (accepted[0].effect,)]
    assert rejected
    assert not any(own.accepted for own in rejected)


def test_verdicts_compare_the_numbers_that_they_show(found):
    for own in found.discovery.found.judgements:
        for verdict in own.verdicts:
            if verdict.test in {"evidence", "loudness"}:
                assert verdict.passed == (verdict.value >= verdict.threshold)
            elif verdict.test.startswith("size"):
                assert verdict.passed == (verdict.value > verdict.threshold)
