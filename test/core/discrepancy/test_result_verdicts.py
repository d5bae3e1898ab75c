# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What speaks against the result of a search, in true sentences; candidates by their evidence."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from quadpi_core.discrepancy.augmented_simulation import write_addition
from quadpi_core.discrepancy.closure import Closing
from quadpi_core.discrepancy.discrepancy_result import (
    BeforeAfter,
    ClosedLoops,
    Coverage,
    FoundParameter,
    Reflights,
    Rollouts,
)
from quadpi_core.discrepancy.other_simulations import CallableSimulation
from quadpi_core.discrepancy.result_verdicts import (
    Unexplained,
    checks,
    is_rejected,
    judge_agreement,
    judge_closed,
    judge_coefficients,
    judge_coefficients_together,
    judge_colour,
    judge_not_zero,
    judge_rollouts,
    judge_unexplained,
    judged_by_rollouts,
    unexplained_share,
    with_stated_coefficients,
)
from quadpi_core.discrepancy.study import discover
from quadpi_core.discrepancy.unexplained import Inside
from quadpi_core.flight import AXES
from quadpi_core.frames import rotate_world_to_body

GUST_N = 0.15
WORSE = "roll-outs of flights left out get worse with it"


def gusty(flight, vehicle, pushed, seed):
    """The flight in gusts from east and west that change in about a second, as no function predicts."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, flight.time[-1], int(flight.time[-1]) + 2)
    east = np.zeros((len(flight), 3))
    east[:, 1] = np.interp(flight.time, time, GUST_N * rng.standard_normal(len(time)))
    wrench = np.zeros((len(flight), 6))
    wrench[:, :3] = rotate_world_to_body(flight.attitude, east)
    return pushed(flight, vehicle, wrench)


def doubted(study, **changes):
    """The doubts about a study whose result is changed."""
    discovery = study.discovery
    given = {
        "found": discovery.found,
        "effects": discovery.effects,
        "left": Unexplained(np.zeros(6), discovery.unexplained, ""),
        "gap": discovery.gap,
    }
    return tuple(check.sentence for check in checks(**(given | changes)) if not check.passed)


def holding(found, held):
    """The result of a search beside intervals that hold some axes (6,) of its flights."""
    shares = np.where(np.broadcast_to(held, 6), 1.0, 0.0)
    return replace(found, inside=Inside(np.tile(shares, (4, 1)), 0.95))


def test_nothing_speaks_against_what_is_there(found):
    assert doubted(found) == found.discovery.doubts == ()


def test_gusts_are_no_noise_of_sensors(simulation, flights, pushed):
    blown = [gusty(flight, simulation.vehicle, pushed, seed) for seed, flight in enumerate(flights)]
    discovery = discover(simulation, blown, names=["payload", "rotor_drag"])
    assert discovery.verdict == "unknown"
    assert any("times as large at slow frequencies" in sentence for sentence in discovery.doubts)
    # A model whose intervals hold all axes has stated as much; one whose intervals are broken has not.
    held = holding(discovery.found, True)
    judged = checks(held, (), Unexplained(np.zeros(6), 0.0, ""), discovery.gap)
    assert all(check.passed for check in judged)


@pytest.mark.parametrize("broken", [(), *combinations(AXES, 1), ("Fx", "Mz"), AXES])
def test_none_is_said_only_where_intervals_hold_every_axis(found, broken):
    """As `evaluate` says of the same flights; with effects that explain it, it is one."""
    searched = holding(found.discovery.found, [axis not in broken for axis in AXES])
    left, gap = Unexplained(np.zeros(6), 0.0, ""), found.discovery.gap
    result = replace(found.discovery, found=searched, effects=(), checks=checks(searched, (), left, gap))
    if not broken:
        assert result.verdict == "none"
        return
    assert result.verdict == "unknown"
    sentence = f"the intervals of {', '.join(broken)} hold less of these flights than they state"
    assert sentence in result.doubts
    assert sentence not in doubted(found, found=searched)


def test_a_force_that_wanders_slowly_is_a_gap_that_stays(simulation, dragged, pushed):
    """The regression counts gusts as noise, beside which drag closes all; the floor of sensors does not."""
    blown = [gusty(flight, simulation.vehicle, pushed, seed) for seed, flight in enumerate(dragged)]
    discovery = discover(simulation, blown, names=["body_drag"])
    assert [effect.name for effect in discovery.effects] == ["body_drag"]
    hidden = discovery.found.closing.gap(discovery.found.regression.noise.variance, np.zeros(6))
    assert hidden.reduction > 0.97
    assert hidden.floor[1] > 0.06
    assert discovery.gap.floor[1] < 0.004
    assert discovery.gap.reduction < 0.6
    failed = {check.test for check in discovery.checks if not check.passed}
    assert "closed" in failed


def test_a_coefficient_far_beyond_its_tolerance_stands_for_something_else(simulation, flights):
    """Thrust is 10 % off and its tolerance is 1 %, but no name for that is looked for."""
    discovery = discover(simulation.with_coefficients({"thrust": 10.0}), flights, names=["moment_bias"])
    assert discovery.verdict == "unknown"
    (sentence,) = [one for one in discovery.doubts if "tolerances" in one]
    assert sentence.startswith("thrust would be wrong by ")


def test_many_coefficients_near_their_limit_stand_for_something_else(found):
    """None of them is far by itself. Those that explain less than noise count as 0."""
    own = found.discovery.found
    count = len(own.regression.tolerances.names)
    # Of the columns of a fit, those of tolerances come first.
    coefficients = np.where(own.fit.fitted <= count, 4.0, own.fit.coefficients)
    fit = replace(own.fit, coefficients=coefficients)
    (sentence,) = doubted(found, found=replace(own, fit=fit))
    assert sentence.startswith(f"{count} coefficients would be wrong by 3.8 of their tolerances")
    # Axes that the simulation's own intervals hold raise no doubt.
    assert doubted(found, found=holding(replace(own, fit=fit), True)) == ()


def test_a_coefficient_that_explains_nothing_may_be_far(found):
    """As one of motion in a hover, which only noise of the estimator moves."""
    own = found.discovery.found
    fit = replace(own.fit, coefficients=np.where(own.fit.fitted == 1, 9.0, own.fit.coefficients))
    far = doubted(found, found=replace(own, fit=fit))
    assert any("would be wrong by 9.0 of its tolerances" in sentence for sentence in far)
    tolerances = own.regression.tolerances
    hardly = np.append(1e-6, np.ones(tolerances.coefficients.width - 1))
    quiet = tolerances.coefficients.like(lambda k: tolerances.coefficients.spectra[k].rows * hardly)
    parts = tuple(quiet if part is tolerances.coefficients else part for part in own.fit.parts)
    still = replace(own.regression, tolerances=tolerances._replace(coefficients=quiet))
    assert doubted(found, found=replace(own, fit=replace(fit, parts=parts), regression=still)) == ()


def test_a_coefficient_is_as_far_off_as_its_own_column_and_that_of_its_law_say(simulation, flights, pushed):
    """Drag of a function is wrong by 12 tolerances in Fx and Fy, half of the variance of which is shared."""
    function = CallableSimulation("function", simulation.vehicle, simulation.wrench)
    share = function.tolerances.coefficient * np.sqrt(0.5)
    dragged = []
    for flight in flights:
        columns = {column.name: column.wrench for column in function.uncertain(flight)}
        drag = sum(columns[f"{axis} of airspeed"] for axis in ("Fx", "Fy")) / share
        off = 12.0 * function.tolerances.coefficient * drag
        dragged.append(pushed(flight, simulation.vehicle, off))
    discovery = discover(function, dragged, names=["moment_bias"])
    (check,) = (check for check in discovery.checks if check.test == "coefficients")
    assert not check.passed
    assert re.match(r"F[xy] of airspeed would be wrong by 1[0-3]", check.sentence)


def test_an_effect_has_to_close_the_gap(found):
    (sentence,) = doubted(found, gap=found.discovery.gap._replace(reduction=0.2))
    assert sentence == "20 % of the gap is closed, 80 % needed"


def test_an_effect_whose_intervals_hold_zero_is_doubted(found):
    (effect,) = found.discovery.effects
    near = [replace(own, lower=-own.upper) for own in effect.parameters]
    assert doubted(found, effects=[replace(effect, parameters=tuple(near))]) == (
        "every parameter of body_drag may be zero",
    )


def test_an_effect_on_which_flights_disagree_is_doubted(found, monkeypatch):
    assert [check.passed for check in found.discovery.checks if check.test == "agreement"] == [True]
    differs = np.array([0.5, 4.0, 1.0])
    monkeypatch.setattr(Closing, "disagreement", lambda *_: differs)
    (sentence,) = doubted(found, gap=found.discovery.gap._replace(reduction=0.94))
    assert sentence == (
        "flights differ in y_n_s2_m2 of body_drag by 4.0 times what one fit to all leaves open, 3 allowed, "
        "and 6 % of the gap stays"
    )
    # What closes the gap all the same describes all flights.
    assert doubted(found, gap=found.discovery.gap._replace(reduction=0.96)) == ()
    agreed = judge_agreement("x", 4.0, 0.96)
    assert agreed.passed
    assert agreed.sentence.endswith("3 allowed, but no more than 4 % of the gap stays")
    anew = with_stated_coefficients(found.discovery)
    assert sorted(check.test for check in anew.checks) == sorted(c.test for c in found.discovery.checks)
    # Of three flights, each that is left out shows something of its own.
    own = found.discovery.found
    three = replace(own, regression=replace(own.regression, flights=own.regression.flights[:3]))
    assert not three.disagreement(own.chosen[0]).any()


@pytest.mark.parametrize(
    ("intervals", "zero"),
    [
        ([(-1.0, 1.0)], True),
        ([(0.5, 1.0), (-1.0, 1.0)], False),
        ([(2.0, 2.0), (-1.0, 1.0)], True),
        ([(2.0, 2.0)], False),
    ],
)
def test_one_parameter_that_differs_from_zero_is_enough(found, intervals, zero):
    """A value without an interval, such as the number of a rotor, was not estimated."""
    (effect,) = found.discovery.effects
    parameters = tuple(FoundParameter("p", "N", 0.5 * (a + b), a, b) for a, b in intervals)
    assert judge_not_zero(replace(effect, parameters=parameters)).passed is not zero


def rolled_out(after, *, lost=0):
    """Roll-outs whose error of attitude was 18 degrees before."""
    errors = {"velocity_m_s": BeforeAfter(1.0, 0.4, 0.1), "attitude_deg": BeforeAfter(18.0, after, 1.0)}
    return alone(Rollouts(0.5, 100, errors, {"before": 2, "after": lost, "floor": 0}))


def alone(rollouts):
    """Nothing but roll-outs."""
    return Reflights(rollouts, ClosedLoops(0), {})


def test_an_effect_that_improves_roll_outs_is_added(found, tmp_path):
    kept = judged_by_rollouts(found.discovery, rolled_out(after=9.0))
    assert kept.verdict == found.discovery.verdict
    assert [check.test for check in kept.checks if check.passed][-2:] == ["roll-outs", "diverged roll-outs"]
    assert write_addition(kept, tmp_path)


@pytest.mark.parametrize(
    ("before", "after", "reason"),
    [
        (0.72, 0.6, ""),
        (0.72, 0.5, "intervals hold 50 % of Fz with it, 72 % before"),
        (0.05, 0.45, "intervals hold 45 % of Fz with it, 5 % before, 48 % needed"),
    ],
)
def test_an_effect_with_which_intervals_miss_most_of_an_axis_or_much_more_is_not_added(
    found, before, after, reason
):
    inside = Inside(np.full((8, 6), 0.5), 0.95)
    discovery = replace(found.discovery, found=replace(found.discovery.found, inside=inside))
    coverage = {"Fz": Coverage(before, after), "Mx": Coverage(0.5, 0.95)}
    judged = judged_by_rollouts(discovery, rolled_out(after=9.0)._replace(coverage=coverage))
    assert (judged.verdict == found.discovery.verdict) is not bool(reason)
    assert judged.doubts == (reason,) * bool(reason)


@pytest.mark.parametrize(
    ("rollouts", "reason"),
    [
        (
            rolled_out(after=108.0),
            "roll-outs of flights left out get worse with it: attitude [deg] 18 to 108",
        ),
        (rolled_out(after=9.0, lost=3), "3 roll-outs of flights left out diverge with it, 2 before"),
    ],
)
def test_what_makes_roll_outs_worse_is_not_added(found, tmp_path, rollouts, reason):
    rejected = judged_by_rollouts(found.discovery, rollouts)
    assert rejected.verdict == "unknown"
    assert rejected.doubts == (reason,)
    assert write_addition(rejected, tmp_path) is None
    assert not list(tmp_path.iterdir())


def diverged(before, after):
    """Roll-outs that all diverge without the effects, and so compare nothing."""
    return alone(Rollouts(0.5, 0, {}, {"before": before, "after": after, "floor": 0}))


def test_a_doubtful_effect_is_not_added_however_roll_outs_gain(found, tmp_path):
    """Without doubts, flights left out a step ahead are enough."""
    doubtful = replace(found.discovery, checks=(judge_closed(0.5),))
    for rollouts in (rolled_out(after=9.0), diverged(209, 0)):
        assert write_addition(judged_by_rollouts(doubtful, rollouts), tmp_path) is None
    kept = judged_by_rollouts(found.discovery, diverged(209, 0))
    assert kept.verdict == "effects"
    assert "no roll-out of flights left out can be compared" in [check.sentence for check in kept.checks]
    assert write_addition(kept, tmp_path)


def test_what_makes_flights_left_out_worse_is_not_added(found, tmp_path):
    gap = found.discovery.gap._replace(reduction=-3.0)
    grown = replace(found.discovery, gap=gap, checks=(judge_closed(gap.reduction),))
    assert is_rejected(grown)
    assert write_addition(judged_by_rollouts(grown, rolled_out(after=9.0)), tmp_path) is None


def test_the_axis_that_most_is_left_of_is_told():
    """A sixth of one loud axis has no name, which is little beside all that is explained."""
    left, named, rows = np.zeros(6), np.full(6, 1000.0), 100
    left[4], named[4] = 300.0, 300.0
    assert unexplained_share(left, named, rows) == (0.5, "My")
    sentence = "50 % of what can be predicted of My has no name, 5 % allowed"
    assert judge_unexplained(0.5, "My").sentence == sentence
    assert unexplained_share(np.zeros(6), named, rows) == (0.0, "")


def test_sentences_of_tests_that_hold_are_true():
    held = judge_coefficients(0.02, 8.0, "thrust")
    assert held.passed
    assert held.sentence.endswith("but explains no more than 2 % by that")
    none = judge_coefficients(0.0, 0.0, "")
    assert none.sentence == "no coefficient is wrong by more than 5 of its tolerances"
    quiet = judge_colour(np.full(6, 20.0), np.zeros(6))
    assert quiet.passed
    assert quiet.sentence.startswith("no axis has more slow noise")
    assert judge_rollouts({"rates": (2.0, 1.0)}).sentence.startswith(
        "roll-outs of flights left out do not get worse"
    )
    assert judge_closed(0.6, 0.2, 0.05).sentence == (
        "60 % of the gap is closed, and no axis is left 10 % above its floor"
    )
    assert judge_closed(-4.35).sentence == "the gap of flights left out grows by 435 %"


@pytest.mark.parametrize(
    ("share", "squares", "count", "passed", "end"),
    [
        (1.0, 24.9, 1, True, "5.0 allowed"),
        (1.0, 25.1, 1, False, "5.0 allowed"),
        # Of thirty, each may be wrong by 1.67 tolerances.
        (1.0, 30 * 1.66**2, 30, True, "1.7 allowed"),
        (1.0, 30 * 1.68**2, 30, False, "wrong by 1.7 of their tolerances, root mean square, 1.7 allowed"),
        (0.02, 270.0, 30, True, "but explain no more than 2 % by that"),
        (0.0, 0.0, 30, True, "no coefficient has to be wrong"),
        (0.0, 0.0, 0, True, "no coefficient has to be wrong"),
    ],
)
def test_coefficients_together_are_judged_as_one_alone(share, squares, count, passed, end):
    verdict = judge_coefficients_together(share, squares, count)
    assert verdict.passed is passed
    assert verdict.sentence.endswith(end)


@pytest.fixture(scope="module")
def ranked(found):
    return found.discovery.candidates


def test_named_effects_come_first_then_those_with_most_of_what_they_need(ranked):
    assert [own.name for own in ranked if own.named] == ["body_drag"]
    assert ranked[0].named
    shares = [own.gain / own.needed for own in ranked[1:] if own.gain is not None]
    assert shares == sorted(shares, reverse=True)
    assert len({own.label for own in ranked}) == len(ranked)


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
