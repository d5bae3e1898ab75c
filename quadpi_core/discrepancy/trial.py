# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The tests that a candidate of the search has to pass, in their order.

A candidate is accepted if it passes all of :data:`ACCEPTANCE_TESTS`, and is not judged further once it fails
one. The thresholds are in `acceptance`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from quadpi_core.discrepancy.acceptance import (
    ORDINARY,
    judge_difference,
    judge_evidence,
    judge_largest,
    judge_left_out,
    judge_loudness,
    judge_size,
    scales_beside_law,
)
from quadpi_core.discrepancy.candidates import Candidate
from quadpi_core.discrepancy.closure import Closing
from quadpi_core.discrepancy.effect_regression import Regression, refined
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.discrepancy.verdict import Verdict
from quadpi_core.frames import Array


@dataclass(frozen=True)
class Trial:
    """A candidate beside the effects accepted before it; each quantity that a test uses is computed once.

    Attributes:
        regression: regression before the candidate.
        chosen: indices of the effects accepted before.
        found: their fit.
        added: index of the candidate.
        fit: fit of all together; None where bounds exclude one.
        needed: evidence that the candidate has to gain.
        dropped: whether it was accepted earlier and dropped beside a better one.
        behind: name of a better candidate that ended the round; empty without one.
        instead: name of a candidate of ordinary size that does about as well; empty without one.
        squares_before: gives the squares (6,) of flights left out before the candidate.
    """

    regression: Regression
    chosen: tuple[int, ...]
    found: Fit
    added: int
    fit: Fit | None
    needed: float
    dropped: bool
    behind: str
    instead: str
    squares_before: Callable[[], Array]

    @property
    def candidate(self) -> Candidate:
        """The candidate."""
        return self.regression.candidates[self.added]

    @property
    def larger(self) -> tuple[int, ...]:
        """Indices of all effects together."""
        return tuple(sorted((*self.chosen, self.added)))

    @property
    def fitted(self) -> Fit:
        """The fit, of a trial that passed the test of bounds."""
        assert self.fit is not None
        return self.fit

    @property
    def gain(self) -> float:
        """Evidence that the candidate gains."""
        return self.fitted.log_evidence - self.found.log_evidence

    @property
    def loudness(self) -> float:
        """Loudness of the candidate, see :meth:`Regression.loudness`."""
        return self.regression.loudness(self.added, self.fitted)

    @cached_property
    def refined(self) -> tuple[Regression, Fit] | None:
        """Regression linearised where all fit together, and that fit."""
        return refined(self.regression, self.larger, self.fitted)

    @property
    def refinement(self) -> tuple[Regression, Fit]:
        """:attr:`refined` of a trial that passed the test of bounds after it."""
        assert self.refined is not None
        return self.refined

    @cached_property
    def reweighted(self) -> Regression:
        """The refined regression with at least the residual after the set as noise."""
        regression, found = self.refinement
        return regression.beside(self.larger, found)

    @cached_property
    def accepted_fit(self) -> Fit | None:
        """Fit of all together in :attr:`reweighted`."""
        return self.reweighted.fit(self.larger)

    def sizes(self, regression: Regression, found: Fit) -> dict[str, float]:
        """Size of each effect in a fit, by its name."""
        return {regression.candidates[i].name: regression.size(i, found) for i in self.larger}

    def judged(self) -> tuple[tuple[Verdict, ...], bool]:
        """Verdicts up to the first that fails, and whether that one ends the round."""
        verdicts = []
        for test in ACCEPTANCE_TESTS:
            verdicts.append(test.judge(self))
            if not verdicts[-1].passed:
                return tuple(verdicts), test.ends_round
        return tuple(verdicts), False


def _possible(test: str, fit: object) -> Verdict:
    sentence = "fits with possible parameters" if fit else "does not fit with possible parameters"
    return Verdict(test, bool(fit), float(bool(fit)), 1.0, "", sentence)


def _ordinary(trial: Trial) -> Verdict:
    size = trial.regression.size(trial.added, trial.fitted)
    return judge_largest(trial.candidate.label, size, trial.instead)


def _not_dropped(trial: Trial) -> Verdict:
    sentence = "became idle beside a better one" if trial.dropped else "was not dropped before"
    return Verdict("not dropped", not trial.dropped, float(trial.dropped), 0.0, "", sentence)


def _precedence(trial: Trial) -> Verdict:
    beside = [trial.regression.candidates[index] for index in trial.chosen]
    passed = not trial.behind or scales_beside_law(trial.candidate, beside)
    sentence = f"gains less than {trial.behind}, which was rejected"
    if passed:
        sentence = "no better candidate was rejected for good"
    return Verdict("precedence", passed, float(passed), 1.0, "", sentence)


def _left_out(trial: Trial) -> Verdict:
    regression, _ = trial.refinement
    after = Closing.by_laws(regression, trial.larger).left_out_squares()
    return judge_left_out(trial.squares_before(), after, len(regression.flights))


def _size_by_law(trial: Trial) -> Verdict:
    """Whether every effect is large enough by its law alone, without columns for the error of its form."""
    regression = trial.reweighted
    plain = regression.fit(trial.larger, form=False)
    sizes = {trial.candidate.name: 0.0} if plain is None else trial.sizes(regression, plain)
    return judge_size(sizes, "size by its law")


def _differs_from_zero(trial: Trial) -> Verdict:
    """Whether, by its law alone, the parameters of the candidate together differ from zero."""
    regression = trial.reweighted
    plain = regression.fit(trial.larger, form=False)
    value = 0.0
    if plain is not None:
        kept = np.isin(plain.columns, regression.block(trial.added).parameters)
        own = plain.coefficients[kept]
        value = float(own @ np.linalg.solve(plain.covariance[np.ix_(kept, kept)], own))
    return judge_difference(value, len(trial.candidate.free))


@dataclass(frozen=True)
class AcceptanceTest:
    """One test of a candidate.

    Attributes:
        name: name of the test in its verdicts.
        judge: gives the verdict.
        ends_round: whether a candidate that fails ends the round. The residual is then noise, or the error of
            a law, and an effect that fits less well would be named for the same. Otherwise the next best
            candidate is tried.
    """

    name: str
    judge: Callable[[Trial], Verdict]
    ends_round: bool


ACCEPTANCE_TESTS = (
    AcceptanceTest("bounds", lambda trial: _possible("bounds", trial.fit), False),
    AcceptanceTest("size", lambda trial: judge_size(trial.sizes(trial.regression, trial.fitted)), False),
    AcceptanceTest(ORDINARY, _ordinary, False),
    # Two effects could replace each other forever.
    AcceptanceTest("not dropped", _not_dropped, False),
    AcceptanceTest("evidence", lambda trial: judge_evidence(trial.gain, trial.needed), True),
    AcceptanceTest("precedence", _precedence, False),
    AcceptanceTest("loudness", lambda trial: judge_loudness(trial.loudness), True),
    # From here on with all linearised where they fit together.
    AcceptanceTest("bounds, refined", lambda trial: _possible("bounds, refined", trial.refined), True),
    AcceptanceTest("flights left out", _left_out, False),
    AcceptanceTest("size, refined", lambda t: judge_size(t.sizes(*t.refinement), "size, refined"), True),
    # With at least the residual after the set as noise.
    AcceptanceTest("size by its law", _size_by_law, True),
    AcceptanceTest("differs from zero", _differs_from_zero, False),
    AcceptanceTest("bounds, reweighted", lambda t: _possible("bounds, reweighted", t.accepted_fit), True),
)
