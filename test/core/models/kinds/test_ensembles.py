# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles of networks, by bootstrap and quality-driven: the noise that they learn, and how few count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.random_ensembles import random_ensemble
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.kinds.bootstrap import Bootstrap
from quadpi_core.models.kinds.quality_driven import FittedQualityDriven, QualityDriven

from ..small_fits import QUICK, REGRESSORS, axis_of, fit, input_vectors, interval, spread, table

pytest.importorskip("torch")


def test_few_members_count_for_more_than_their_variance() -> None:
    """t with nine degrees of freedom and √(1 + 1/B) in place of the normal quantile."""
    few = axis_of(fit(Bootstrap(**QUICK | {"epochs": 1}), *table(4)))
    assert few.model_share == pytest.approx((2.262157 / 1.959964) ** 2 * 1.1, rel=1e-5)
    paper = axis_of(fit(Bootstrap(epochs=1, hidden=5), *table(4), settings="paper"))
    assert paper.model_share == 1.0
    assert paper.floor == pytest.approx(1e-3)


def test_noise_is_learned_where_it_is() -> None:
    """A target of noise alone, ten times as loud on one side."""
    rng = np.random.default_rng(8)
    X = rng.uniform(-1.0, 1.0, size=(1800, 2))
    loud = X[:, 0] > 0.0
    y = np.where(loud, 1.0, 0.1) * rng.normal(size=len(X))
    kind = Bootstrap(**QUICK | {"epochs": 15, "folds": 0, "members": 4})
    fitted = fit(kind, input_vectors(X), y, np.repeat(np.arange(6), 300)).fitted
    away = np.abs(X[:, 0]) > 0.3
    found = spread(fitted, input_vectors(X))
    assert found[loud & away].mean() == pytest.approx(1.0, rel=0.25)
    assert found[~loud & away].mean() < 0.4


def test_noise_is_small_where_every_flight_is_learned_to_the_last_digit() -> None:
    line = np.random.default_rng(0).uniform(-1.0, 1.0, size=(600, 1))
    exact = Bootstrap(**QUICK | {"epochs": 60, "folds": 0, "members": 3})
    fitted = fit(exact, input_vectors(line), line[:, 0], np.repeat(np.arange(20), 30))
    assert axis_of(fitted).floor < 0.01


def test_noise_is_no_less_than_the_typical_offset_of_a_flight() -> None:
    """As for bounds (see below), without the quantile."""
    X, _, flights = table(5)
    y = np.where(flights % 2, 1.0, -1.0)
    fitted = fit(Bootstrap(**QUICK | {"epochs": 3, "folds": 0}), X, y, flights)
    assert axis_of(fitted).floor == pytest.approx(1.2 / 7.0**0.5, rel=0.1)


# Quality-driven ensembles: how far bounds move outward, and the confidence that they are trained for.


@pytest.mark.parametrize("distance", [-3.0, 0.0])
def test_bounds_that_cross_or_meet_still_hold_an_interval(X: Array, distance: float) -> None:
    ensemble = random_ensemble("quality-driven", X, REGRESSORS, members=4, units=5)
    members = replace(
        ensemble.members,
        output_weights=np.repeat(ensemble.members.output_weights[:, :1], 2, axis=1),
        output_biases=np.tile([0.0, distance], (4, 1)),
    )
    fitted = FittedQualityDriven({"Fx": replace(ensemble, members=members, outward=0.0)})
    np.testing.assert_allclose(spread(fitted, X), 0.3 * max(0.5 * abs(distance), ensemble.floor))


def test_bounds_of_the_paper_are_for_the_confidence_of_training() -> None:
    """And move by the error of the mean, of ten members the standard deviation over √10."""
    pytest.importorskip("torch")
    X, y, flights = table(4)
    paper = fit(QualityDriven(epochs=2), X, y, flights, settings="paper", confidence=0.9)
    assert axis_of(paper).outward == pytest.approx(1.959964 / 10**0.5, rel=1e-6)
    interval(paper.fitted, X, 0.9)
    with pytest.raises(ModelError, match=r"trained for a confidence of 0\.9, not 0\.95"):
        interval(paper.fitted, X, 0.95)


def test_half_distance_is_no_less_than_the_typical_offset_of_a_flight() -> None:
    """Flights alternate between -1 and 1, which no input tells.

    The middle of a member without one of six lies from 0 to 0.2 the other way, so it is off by 1 to 1.2. As
    a seventh flight counts with ordinary errors, the floor is 1.96 / √7 of that.
    """
    pytest.importorskip("torch")
    X, _, flights = table(5)
    y = np.where(flights % 2, 1.0, -1.0)
    found = fit(QualityDriven(**QUICK | {"epochs": 3, "folds": 0}), X, y, flights)
    own = axis_of(found)
    assert own.floor == pytest.approx(1.96 * 1.1 / 7.0**0.5, rel=0.12)
    assert own.outward == pytest.approx(1.959964, rel=1e-6)
    assert np.all(spread(found.fitted, X) >= 0.999 * own.floor * own.scaling.target_scale)
