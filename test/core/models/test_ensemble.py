# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Both ensembles: what they learn, cover, refuse, and repeat."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.ensemble import Ensemble, Plan, Table
from quadpi_core.models.interval_rules import HeldOutRule, NormalRule, TrainedRule
from quadpi_core.models.kinds.bootstrap import Bootstrap
from quadpi_core.models.kinds.quality_driven import QualityDriven
from quadpi_core.models.model_kind import Fit
from quadpi_core.models.regressors import CandidatePool, Regressor

from .small_fits import (
    AXIS,
    COLUMNS,
    FLIGHTS,
    QUICK,
    axis_of,
    fit,
    input_vectors,
    interval,
    noise,
    prediction,
    samples_of,
    table,
)

pytest.importorskip("torch")

KINDS = (Bootstrap, QualityDriven)


@pytest.fixture(scope="module", params=KINDS)
def fitted(request: pytest.FixtureRequest) -> Fit:
    return fit(request.param(**QUICK), *table(0))


def test_learns_the_target_and_covers_new_flights(fitted: Fit) -> None:
    X, y, _ = table(1, flights=20)
    lower, upper = interval(fitted.fitted, X)
    inside = (lower <= y) & (y <= upper)
    assert np.var(y - prediction(fitted.fitted, X)) < 0.1 * np.var(y)
    # The largest factor of six flights is on the safe side.
    assert 0.93 < inside.mean() < 0.995
    assert inside.reshape(20, -1).mean(axis=1).min() > 0.9
    narrow, wide = noise(X) < 0.1, noise(X) > 0.2
    assert np.mean((upper - lower)[wide]) > 1.05 * np.mean((upper - lower)[narrow])


def test_more_confidence_is_a_wider_interval_around_the_prediction(fitted: Fit) -> None:
    X = table(2)[0]
    lower, upper = interval(fitted.fitted, X, 0.8)
    wider_lower, wider_upper = interval(fitted.fitted, X, 0.95)
    assert np.all((wider_lower < lower) & (upper < wider_upper))
    np.testing.assert_allclose(0.5 * (lower + upper), prediction(fitted.fitted, X))


def test_every_flight_calibrates_while_it_is_left_out(fitted: Fit) -> None:
    rule = axis_of(fitted).rule
    assert isinstance(rule, HeldOutRule)
    assert (len(rule.flight_factors), rule.flights_inside) == (FLIGHTS, FLIGHTS)
    covered = rule.held_out_coverage(fitted.held_out[AXIS], 0.95)
    assert covered.shape == (FLIGHTS,)
    assert np.all(covered > 0.85)


@pytest.mark.parametrize("kind", KINDS)
def test_repeats_for_a_seed_and_differs_for_another(kind: type[Ensemble]) -> None:
    X, y, flights = table(3)
    few = QUICK | {"epochs": 2, "folds": 0}
    one, again, other = (
        prediction(fit(kind(**few, seed=seed), X, y, flights).fitted, X) for seed in (7, 7, 8)
    )
    np.testing.assert_array_equal(one, again)
    assert not np.allclose(one, other)


@pytest.mark.parametrize(("kind", "rule"), [(Bootstrap, NormalRule()), (QualityDriven, TrainedRule(0.9))])
def test_settings_of_the_paper(kind: Any, rule: Any) -> None:
    """Ten members of twenty units, samples split, nothing calibrated, bounds for one confidence."""
    X, y, flights = table(4)
    paper = fit(kind(epochs=3), X, y, flights, settings="paper", confidence=0.9)
    assert axis_of(paper).members.hidden_weights.shape == (10, 20, 3)
    assert axis_of(paper).rule == rule
    assert not paper.held_out
    lower, upper = interval(paper.fitted, X, 0.9)
    assert np.all(lower < upper)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda X, y, flights: (X, np.full_like(y, 2.0), flights), f"{AXIS}: .*constant"),
        (lambda X, y, flights: (X, y, np.zeros_like(flights)), "one flight"),
    ],
)
def test_what_cannot_be_learned_from_is_refused(kind: type[Ensemble], change: Any, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        fit(kind(**QUICK), *change(*table(7)))


# Tables of samples and plans of ensembles: what networks see, in which units, and what they leave out.


@pytest.mark.parametrize("split", ["flight", "sample"])
def test_no_network_of_a_turn_sees_a_flight_left_out_in_it(split: Any) -> None:
    flights = np.repeat(np.arange(7), 50)
    plan = Plan.make(flights, members=10, subset=0.8, split=split, folds=4, seed=0)
    assert sorted(np.concatenate(plan.left_out).tolist()) == list(range(7))
    for turn, left_out in enumerate(plan.left_out):
        networks = plan.networks(turn)
        trained, omitted = plan.trained[networks][:, plan.unit], plan.omitted[networks][:, plan.unit]
        outside = np.isin(flights, left_out)
        assert not trained[:, outside].any()
        assert not omitted[:, outside].any()
        assert not (trained & omitted).any()
        assert (trained | omitted)[:, ~outside].all()
        # All are left out about equally often, so that each sample has networks that do not know it.
        assert omitted[:, ~outside].any(axis=0).all()
        if split == "flight":
            whole = [np.unique(row[flights == flight]) for row in omitted for flight in range(7)]
            assert all(len(values) == 1 for values in whole)


def small_table(flights: Any, *, samples: int = 60, most: int | None = None) -> Table:
    """A table of two axes: one takes two regressors, the other three."""
    rng = np.random.default_rng(1)
    X = rng.normal(3.0, 2.0, size=(samples, len(INPUT_NAMES)))
    held = samples_of(X, 10.0 + 5.0 * rng.normal(size=samples), flights)
    held.wrench[:, 0] = rng.normal(size=samples)
    pools = {
        AXIS: CandidatePool((), (), tuple(map(Regressor.parse, ("u", "|v|*w")))),
        "Fx": CandidatePool((), (), tuple(map(Regressor.parse, "uvw"))),
    }
    return Table.make(held, pools, most)


def test_inputs_and_targets_of_each_axis_have_mean_zero_and_unit_deviation() -> None:
    table = small_table(np.repeat([0, 1], 30))
    assert table.features.shape == (60, 2, 3)
    np.testing.assert_allclose(table.features.mean(axis=0), 0.0, atol=1e-6)
    deviation = table.features.std(axis=0)
    np.testing.assert_allclose(deviation[0, :2], 1.0, rtol=1e-5)
    assert deviation[0, 2] == 0.0
    np.testing.assert_allclose(deviation[1], 1.0, rtol=1e-5)
    np.testing.assert_allclose(table.targets.mean(axis=1), 0.0, atol=1e-6)
    np.testing.assert_allclose(table.targets.std(axis=1), 1.0, rtol=1e-5)
    v, w = (table.X[:, INPUT_INDEX[name]] for name in "vw")
    product = np.abs(v) * w
    expected = (product - product.mean()) / product.std()
    np.testing.assert_allclose(table.features[:, 0, 1], expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("most", "kept"), [(60, 60), (59, 31), (20, 20), (19, 16)])
def test_every_kth_sample_of_a_flight_is_kept_where_there_are_too_many(most: int, kept: int) -> None:
    """Of flights of 30, 15 and 15 samples."""
    flights = np.repeat([0, 1, 2], [30, 15, 15])
    table = small_table(flights, most=most)
    step = -(-60 // most)
    assert len(table.X) == kept
    whole = small_table(flights)
    for rows, all_rows in zip(table.rows, whole.rows, strict=True):
        np.testing.assert_array_equal(table.X[rows], whole.X[all_rows[::step]])


def test_a_flight_counts_where_half_of_it_is_inside_the_others() -> None:
    """Flights that reach from 0 to 1, from 0 to 2 and from 0 to 4 in one input."""
    ramp = np.linspace(0.0, 1.0, 101)
    X = input_vectors(np.concatenate([ramp, 2.0 * ramp, 4.0 * ramp])[:, None])
    y = np.random.default_rng(0).normal(size=len(X))
    table = Table.make(samples_of(X, y, np.repeat([0, 1, 2], 101)), {AXIS: COLUMNS}, None)
    everyone = np.arange(3)
    assert table.inside(1, everyone).all()
    assert table.inside(2, everyone).sum() == 51
    assert table.mostly_inside(2, everyone)
    assert table.inside(2, np.array([0, 2])).sum() == 26
    assert not table.mostly_inside(2, np.array([0, 2]))
    assert not table.inside(2, np.array([2])).any()


def test_few_flights_are_left_out_in_fifths_and_three_as_a_whole() -> None:
    for count, pieces in ((2, 5), (3, 1)):
        flights = np.repeat(np.arange(count), 100)
        plan = Plan.make(flights, members=30, subset=0.9, split="flight", folds=0, seed=0)
        omitted = plan.unseen(0)
        per_flight = np.stack([omitted[:, flights == flight].sum(axis=1) for flight in range(count)], axis=1)
        assert set(np.unique(per_flight)) == {0, 100 // pieces}
        # A part is contiguous.
        changes = np.abs(np.diff(omitted.astype(int), axis=1)).sum(axis=1)
        assert changes.max() <= 2


def test_single_samples_are_dealt_to_a_thousand_units() -> None:
    flights = np.repeat(np.arange(2), 5000)
    plan = Plan.make(flights, members=10, subset=0.8, split="sample", folds=0, seed=0)
    assert plan.trained.shape == (10, 1000)
    share = plan.unseen(0).mean(axis=1)
    np.testing.assert_allclose(share, 0.2, atol=1e-3)
    # Neighbours in time are in different units.
    assert np.mean(plan.unit[1:] == plan.unit[:-1]) < 0.01


def test_members_of_an_ensemble_leave_out_their_share_of_flights() -> None:
    """One whose turn spans two rounds may meet a flight twice, and leave out one less."""
    flights = np.repeat(np.arange(10), 20)
    plan = Plan.make(flights, members=10, subset=0.7, split="flight", folds=0, seed=0)
    left_out = plan.unseen(0)[:, ::20]
    assert sorted(left_out.sum(axis=1))[2:] == [3] * 8
    assert set(left_out.sum(axis=0)) <= {2, 3}
