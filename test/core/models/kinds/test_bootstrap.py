# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bootstrap ensembles: the noise that they learn, and how few members count."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.models.kinds.bootstrap import Bootstrap

from ..small_fits import QUICK, axis_of, fit, input_vectors, spread, table

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
    """As for bounds (see `test_quality_driven`), without the quantile."""
    X, _, flights = table(5)
    y = np.where(flights % 2, 1.0, -1.0)
    fitted = fit(Bootstrap(**QUICK | {"epochs": 3, "folds": 0}), X, y, flights)
    assert axis_of(fitted).floor == pytest.approx(1.2 / 7.0**0.5, rel=0.1)
