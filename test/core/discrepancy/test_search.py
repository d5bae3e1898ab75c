# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The search drops an effect that a better one has made idle."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.discrepancy.acceptance import Accepted
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.discrepancy.search import without_idle


class ListedEvidence:
    """A regression in which the evidence of each set is listed, and every effect is linear and exact."""

    def __init__(self, evidence, reweighted=()):
        self.evidence = {tuple(sorted(chosen)): value for chosen, value in evidence.items()}
        effect = SimpleNamespace(scales_existing=False)
        names = [f"effect {k}" for k in range(3)]
        self.candidates = [
            SimpleNamespace(name=name, label=name, form=0.0, linear=True, effect=effect) for name in names
        ]
        self.conditions, self.sound = (), None
        self.points = [np.zeros(1)] * 3
        self.reweighted = reweighted

    def fit(self, chosen, *_, **__):
        count = len(chosen)
        value = self.evidence[tuple(chosen)]
        return Fit(value, (), np.arange(count), np.ones(count), np.eye(count), np.zeros(count))

    def at_points(self, chosen):
        return self.evidence[tuple(chosen)]

    def parameters(self, *_):
        return np.ones(1)

    def size(self, *_):
        return 1.0

    def moved(self, _):
        return self

    def energy(self, chosen, _):
        return self.evidence[tuple(chosen)]

    def beside(self, chosen, _):
        return ListedEvidence(self.evidence, chosen)


@pytest.mark.parametrize(("alone", "kept"), [(1190.0, (1,)), (900.0, (0, 1))])
def test_an_effect_that_a_better_one_made_idle_is_dropped(alone, kept):
    """The first did well until the second came; that one does nearly as well, or does not, without it."""
    regression = ListedEvidence({(0,): 1000.0, (1,): alone, (0, 1): 1200.0})
    both = Accepted(regression, (0, 1), regression.fit((0, 1)))
    after, judgements = without_idle(both, threshold=5.0)
    assert after.chosen == kept
    assert after.fit.log_evidence == regression.evidence[kept]
    dropped = kept != (0, 1)
    assert after.regression.reweighted == (kept if dropped else ())
    assert [own.effect for own in judgements] == ["effect 0"] * dropped
    assert not any(own.accepted for own in judgements)
