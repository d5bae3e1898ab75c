# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The search drops what a better effect made idle, and keeps what flights have of their own apart."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.discrepancy.acceptance import CLOSES_NOTHING, HOLDS_MORE, Accepted, Trial
from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.closure import Gap, SearchResult
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.discrepancy.search import (
    Prepared,
    _beyond_bounds,
    _Search,
    conditions_gaining,
    search,
    without_idle,
)
from quadpi_core.discrepancy.unexplained import Inside
from quadpi_core.discrepancy.whitening import Memoised, Spectrum

from .regressions import regression_of


class ListedEvidence(Memoised):
    """A regression in which the evidence of each set is listed, and every effect is linear and exact."""

    def __init__(self, evidence, reweighted=(), conditions=()):
        self.evidence = {tuple(sorted(chosen)): value for chosen, value in evidence.items()}
        effect = SimpleNamespace(scales_existing=False, brings=())
        names = [f"effect {k}" for k in range(3)]
        self.candidates = [
            SimpleNamespace(name=name, label=name, form=0.0, linear=True, effect=effect) for name in names
        ]
        self.conditions, self.sound = conditions, None
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

    def moves(self, *_):
        return True

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
    after, judgements = without_idle(both)
    assert after.chosen == kept
    assert after.fit.log_evidence == regression.evidence[kept]
    dropped = kept != (0, 1)
    assert after.regression.reweighted == (kept if dropped else ())
    assert [own.effect for own in judgements] == ["effect 0"] * dropped
    assert not any(own.accepted for own in judgements)


LISTED = {(): 0.0, (0,): 800.0, (1,): 800.0, (2,): 900.0, (0, 1): 850.0, (0, 2): 1000.0, (1, 2): 995.0}


def rivals_of_the_first(regression):
    """In the set of the first and the third effect."""
    for candidate in regression.candidates:
        candidate.within, candidate.excludes = False, lambda other, own=candidate: other is own
    return _Search({}, None).rivals(Accepted(regression, (0, 2), regression.fit((0, 2))))[0]


@pytest.mark.parametrize(("curved", "odds"), [((), -5.0), ((1,), 30.0), ((2,), 30.0)])
def test_sets_with_curved_effects_are_compared_where_these_fit_together(curved, odds):
    """About where it fits alone, wind loses to a constant force beside a payload, though both are there."""
    regression = ListedEvidence(LISTED)
    for index in curved:
        regression.candidates[index].linear = False
    regression.moved = lambda _: ListedEvidence(LISTED | {(1, 2): 1030.0})
    # A tenth of what it gains is the margin, for which odds are a hundred.
    assert rivals_of_the_first(regression) == [(1, pytest.approx(np.exp(0.46 * odds)))]


@pytest.mark.parametrize(("brought", "odds"), [("effect 1", 100.0), ("effect 0", 0.01), ("other", 1.0)])
def test_what_another_effect_brings_is_likelier_before_any_flight(brought, odds):
    """A load hangs from a hook: where weight and thrust do alike beside it, it is the weight."""
    regression = ListedEvidence(LISTED)
    regression.candidates[2].effect = SimpleNamespace(scales_existing=False, brings=(brought,))
    assert rivals_of_the_first(regression) == [(1, pytest.approx(odds * np.exp(-0.46 * 5.0), rel=0.01))]


@pytest.mark.parametrize("scales_thrust", [True, False])
def test_beside_a_law_a_rival_of_what_scales_forces_scales_them_too(scales_thrust):
    """As speeds that read fast do; other effects explain the error of the law."""
    regression = ListedEvidence(LISTED)
    first, rival, law = regression.candidates
    first.effect = SimpleNamespace(scales_existing=True, scales_thrust=True, brings=())
    rival.effect = SimpleNamespace(scales_existing=False, scales_thrust=scales_thrust, brings=())
    law.form = 0.3
    assert bool(rivals_of_the_first(regression)) == scales_thrust


@pytest.mark.parametrize(
    ("together", "passes", "named"), [(1060.0, 2, (1, 2)), (1040.0, 2, (0,)), (1060.0, 1, (0,))]
)
def test_two_effects_stand_in_the_place_of_one_that_acts_as_both(monkeypatch, together, passes, named):
    """Where they gain a twentieth more, as a further effect has to beside it, and each passes all tests."""
    sets = {(): 0.0, (0,): 1000.0, (1,): 600.0, (2,): 500.0, (1, 2): together, (0, 1): 1010.0, (0, 2): 1010.0}
    regression, tried = ListedEvidence(sets), []
    for candidate in regression.candidates:
        candidate.within, candidate.excludes = False, lambda other, own=candidate: other is own

    class Passing(Trial):
        def outcome(self):
            tried.append(self.added)
            larger = Accepted(regression, self.larger, regression.fit(self.larger))
            judgement = SimpleNamespace(ends_round=True, reason=SimpleNamespace(test="evidence"))
            return judgement, larger if len(tried) <= passes else None

    monkeypatch.setattr("quadpi_core.discrepancy.search.Trial", Passing)
    one = Accepted(regression, (0,), regression.fit((0,)))
    assert _Search({}, None).parted(one).chosen == named
    assert tried == [1, 2] * (together > 1050.0)
    assert _Search({"effect 1": "so"}, None).parted(one).chosen == (0,)


@pytest.mark.parametrize(
    ("second", "test", "behind"),
    [(905.0, "evidence", ""), (895.0, "evidence", "effect 0"), (905.0, "loudness", "effect 0")],
)
def test_what_does_about_as_well_as_one_refused_may_need_less_evidence(monkeypatch, second, test, behind):
    """As a hook does beside a load, where a weak rotor gains a little more and needs five times as much."""
    regression, told = ListedEvidence({(): 0.0, (0,): 1000.0, (1,): second, (2,): 0.0}), {}
    for candidate in regression.candidates:
        candidate.within, candidate.excludes = False, lambda other, own=candidate: other is own

    def outcome(trial):
        told[trial.added] = trial.behind
        return SimpleNamespace(ends_round=True, reason=SimpleNamespace(test=test)), None

    monkeypatch.setattr(Trial, "outcome", outcome)
    fits = [(index, regression.fit((index,))) for index in range(3)]
    _Search({}, None)._one_more(Accepted(regression, (), regression.fit(())), fits)
    assert told == {0: "", 1: behind, 2: "effect 0"}


@pytest.mark.parametrize(
    ("alone", "gained", "left", "found"),
    [
        (150.0, 250.0, 165.0, 2),
        (150.0, 250.0, 180.0, None),
        (150.0, 153.0, 60.0, None),
        (1000.0, 1250.0, 1140.0, 2),
        (1000.0, 1250.0, 1160.0, None),
    ],
)
def test_what_flights_have_of_their_own_leaves_an_effect_enough_of_its_evidence(alone, gained, left, found):
    """Half is enough, less is not, nor what gains nothing; of much evidence more than 100 nat are enough."""
    regression = ListedEvidence({(): 0.0, (0,): alone})
    regression.conditions_to_come = [2]
    regression.sizes_of_condition = lambda index, _: np.full((4, 1), index)
    regression.with_condition = lambda condition: ListedEvidence(
        {(): left, (0,): gained}, conditions=(condition,)
    )
    own = conditions_gaining(Accepted(regression, (0,), regression.fit((0,))))
    assert [(index, one.fit.log_evidence) for index, one in own] == [(found, gained)] * (found is not None)
    assert all(one.regression.conditions[-1].index == index for index, one in own)


@pytest.mark.parametrize(
    ("barred", "kept"), [({}, True), ({"effect 2": CLOSES_NOTHING}, True), ({"effect 2": HOLDS_MORE}, False)]
)
def test_what_intervals_hold_more_without_is_nothing_that_flights_have_of_their_own(
    monkeypatch, barred, kept
):
    """An effect that explains nothing of all flights may be so of one."""
    regression, conditions = ListedEvidence({(): 0.0}), (SimpleNamespace(index=2),)
    accepted = Accepted(regression, (), regression.fit(()))
    beside = replace(accepted, regression=ListedEvidence({(): 50.0}, conditions=conditions))
    # Of another rotor, with less evidence.
    fewer = replace(accepted, regression=ListedEvidence({(): 40.0}, conditions=()))
    for name, made in (
        ("conditions_gaining", lambda own: [(2, beside), (2, fewer)] * (not own.regression.conditions)),
        ("_fits_with_one_more", lambda _: []),
    ):
        monkeypatch.setattr(f"quadpi_core.discrepancy.search.{name}", made)
    assert _Search(barred, None).grown(accepted).regression.conditions == conditions * kept


@pytest.mark.parametrize(("sound_flights", "least"), [(8, 0.0), (3, 1.2)])
@pytest.mark.parametrize(
    ("before", "share_inside", "of_mean"), [(1.4, 0.5, True), (1.8, 0.5, False), (1.4, 1.0, False)]
)
def test_a_gap_is_beyond_the_mean_of_sound_flights_where_only_intervals_are_broken(
    before, share_inside, of_mean, sound_flights, least
):
    """Else beyond what as many leave at most, here 1.5 times their mean; of few, beyond what is stated."""

    def gap(noise, stated, adjusted, held):  # noqa: ARG001
        floor = np.maximum(noise[:, 0], stated)
        return Gap(np.full(6, before), np.full(6, 0.9), floor, float(adjusted))

    differ = 0.25 / np.sqrt(1.0 / 8.0 + 1.0 / sound_flights)
    sound = SimpleNamespace(left=np.ones((6, 1)), differ=np.full(6, differ), flights=sound_flights)
    regression = SimpleNamespace(sound=sound, flights=[None] * 8, stated_squares=np.full(6, 1.2))
    inside, closing = Inside(np.full((8, 6), share_inside), 0.95), SimpleNamespace(gap=gap)
    left = SimpleNamespace(noise=None)
    found = SearchResult(regression, (), None, closing, {}, left, (), inside=inside)
    assert found.gap().floor == pytest.approx(np.full(6, max(1.0 if of_mean else 1.5, least)))
    # The tests of the result as a whole go by the same.
    assert found.sensors[:, 0] == pytest.approx(np.full(6, max(1.0, least)))


@pytest.mark.parametrize(("stated", "beyond"), [(0.0, np.inf), (1.0, 40 * 0.96), (2.0, 0.0)])
def test_without_sound_flights_as_much_may_be_left_as_intervals_state(stated, beyond):
    """Any, where there are no intervals."""
    left = [np.full((6, 10), 1.4)] * 4
    spectra = [Spectrum(own, np.zeros(10, dtype=np.intp)) for own in left]
    regression = SimpleNamespace(
        sound=None,
        stated_squares=np.full(6, stated),
        residual=SimpleNamespace(spectra=spectra, bands=1),
        left=lambda _: left,
    )
    found = SearchResult(regression, (), SimpleNamespace(left=None), None, {}, None, ())
    assert found.beyond_sound == pytest.approx(np.full(6, beyond))


def test_an_effect_that_flights_ask_for_beyond_its_bounds_is_disputed(simulation, dragged):
    """Half of the drag that they have along x; with room for all of it, it is not."""
    regression = regression_of(simulation, dragged, ["body_drag"])
    drag, at = regression.blocks[0], regression.found(0, regression.fit((0,)))
    for share, disputed in ((0.5, True), (2.0, False)):
        highest = np.where([True, False, False], share * at, np.inf)
        bounded = replace(regression, blocks=(replace(drag, highest=highest),))
        assert bool(_beyond_bounds(Accepted.fitted(bounded, (0,)))) == disputed


def test_what_fitted_coefficients_clearly_prefer_is_named(simulation, dragged, monkeypatch):
    """Here they are made to take another effect for the drag that was named."""
    named = []

    def fitted(_, accepted):
        regression = accepted.regression
        labels = [own.label for own in regression.candidates]
        named.extend(labels[index] for index in accepted.chosen)
        other = (labels.index("force_bias"),)
        return Accepted(regression, other, regression.fit(other))

    monkeypatch.setattr("quadpi_core.discrepancy.search._Search.with_fitted_coefficients", fitted)
    compared = Compared.together(dragged, simulation)
    found = search(
        Prepared.from_flights(compared, candidates(simulation.vehicle, ("body_drag", "force_bias")))
    )
    assert named == ["body_drag"]
    assert [found.regression.candidates[index].label for index in found.chosen] == ["body_drag"]


def test_another_search_of_the_same_flights_begins_where_it_parts_from_the_first(
    simulation, dragged, monkeypatch
):
    """What is barred is not named, and what was judged is judged no more."""
    compared = Compared.together(dragged, simulation)
    prepared = Prepared.from_flights(compared, candidates(simulation.vehicle, ("body_drag", "rate_damping")))
    fresh = [search(prepared), search(prepared, {"body_drag": "so"})]

    def reweighted(*_):
        raise AssertionError

    monkeypatch.setattr("quadpi_core.discrepancy.effect_regression.Regression.beside", reweighted)
    again = [search(prepared), search(prepared, {"body_drag": "so"})]
    labels = [[own.regression.candidates[k].label for k in own.chosen] for own in fresh]
    assert labels[0] == ["body_drag"] != labels[1]
    for first, second in zip(fresh, again, strict=True):
        assert (first.chosen, first.fit, first.judgements) == (second.chosen, second.fit, second.judgements)
