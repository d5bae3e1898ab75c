# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a candidate has to gain, and may enlarge on flights left out; each has a reason."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.discrepancy.acceptance import (
    judge_left_out,
    judge_of_itself,
    least_evidence,
    stands_behind,
)
from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.vehicle import Vehicle

SQUARES = np.full(6, 100.0)


def first_axis(value, others=0.0):
    return np.array([value, *[others] * 5])


def test_what_an_effect_takes_from_one_axis_may_return_in_another():
    """Coefficients settle elsewhere beside a true effect."""
    after = SQUARES + first_axis(200.0, -80.0)
    assert judge_left_out(SQUARES, after, 10).passed == (200.0 <= 0.5 * (100.0 + 200.0))
    assert judge_left_out(SQUARES, SQUARES + first_axis(140.0, -80.0), 10).passed


@pytest.mark.parametrize(
    ("fitted", "stated", "passed"),
    [
        (100.0, 90.0, True),
        (100.0, -300.0, False),
        (0.0, 0.0, True),
        (-50.0, -300.0, True),
        (np.nan, 1.0, False),
    ],
)
def test_what_coefficients_close_beside_an_effect_does_not_speak_for_it(fitted, stated, passed):
    """A wrong rotor makes an axis worse, which coefficients undo; axes that it leaves alone say nothing."""
    assert judge_of_itself(fitted, stated).passed == passed


def test_the_least_evidence_counts_the_candidates():
    """By the sum of their chances: of twelve, twelve times as great odds."""
    assert least_evidence(12) - least_evidence(1) == pytest.approx(np.log(12.0))
    known = candidates(Vehicle.load("bebop2"), None)
    assert len(known) == 35
    assert least_evidence(len(known)) == pytest.approx(8.16, abs=0.005)


def test_the_strength_of_a_rotor_by_one_law_does_not_stand_behind_that_by_another():
    """Other rotors, other effects and the same law do."""
    known = {own.label: own for own in candidates(Vehicle.load("bebop2"), None)}
    rejected = known["weak_rotor (rotor 1)"]
    others = ("weak_rotor (rotor 2)", "rotor_speed_scale (rotor 2)", "cg_offset")
    assert not stands_behind(known["rotor_speed_scale (rotor 1)"], rejected)
    assert all(stands_behind(known[label], rejected) for label in others)


def test_a_search_gives_a_reason_for_every_candidate(found):
    judgements = found.discovery.found.judgements
    accepted = [own for own in judgements if own.accepted]
    assert [own.effect for own in accepted] == [effect.name for effect in found.discovery.effects]
    names = [verdict.test for verdict in accepted[0].verdicts]
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
