# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Candidates in the order of their evidence, and what each closes of the gap."""

from __future__ import annotations

import json

import pytest

from quadpi_core.discrepancy.ranked_evidence import ranked_candidates


@pytest.fixture(scope="module")
def ranked(found):
    return ranked_candidates(found.discovery.found)


def test_named_effects_come_first_then_those_with_most_of_what_they_need(ranked, found):
    assert ranked == found.discovery.candidates
    assert [own.name for own in ranked if own.named] == ["body_drag"]
    assert ranked[0].named
    shares = [own.gain / own.needed for own in ranked[1:] if own.gain is not None]
    assert shares == sorted(shares, reverse=True)
    assert len({own.label for own in ranked}) == len(ranked)


def test_the_evidence_is_that_of_the_search(ranked, found):
    judgements = {own.label: own for own in found.discovery.found.judgements if own.accepted}
    evidence = next(own for own in judgements["body_drag"].verdicts if own.test == "evidence")
    assert (ranked[0].gain, ranked[0].needed) == (evidence.value, evidence.threshold)
    assert ranked[0].gain > ranked[0].needed
    for refused in ranked[1:]:
        assert refused.reason in {own.reason.sentence for own in found.discovery.found.judgements}


def test_the_hidden_effect_closes_the_axes_that_it_acts_in_and_others_hardly_anything(ranked):
    """The flights differ by drag alone, in Fx, Fy and Fz."""
    assert set(ranked[0].closes) >= {"Fx", "Fy"}
    assert all(ranked[0].closes[axis] > 0.8 for axis in ("Fx", "Fy"))
    for refused in ranked[1:]:
        assert all(abs(share) < 0.1 for share in refused.closes.values())


def test_a_candidate_that_cannot_be_fitted_closes_nothing(ranked):
    for own in ranked:
        assert (own.gain is None) == (own.needed is None)
        assert own.gain is not None or not own.closes
    # JSON has no infinity, and no numbers of numpy.
    assert json.loads(json.dumps([own.to_json() for own in ranked], allow_nan=False))
