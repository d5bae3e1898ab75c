# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Every candidate of a search has a reason."""

from __future__ import annotations

from quadpi_core.discrepancy.trial import ACCEPTANCE_TESTS


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
