# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bootstrap ensembles: mean of the members, and spread of members and noise."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.random_ensembles import random_ensemble
from quadpi_core.frames import Array
from quadpi_core.models.kinds.bootstrap import BootstrapEnsemble
from quadpi_core.training.networks import Networks

from ..small_ensembles import QUICK, REGRESSORS, table


def test_bootstrap_is_mean_and_variance_of_members_and_noise(X: Array) -> None:
    ensemble = random_ensemble("bootstrap", X, REGRESSORS, members=4, units=5)
    members, scaling = ensemble.members, ensemble.scaling
    for sample in X[:5]:
        u, v, w = sample[:3]
        features = (np.array([u, abs(v) * w]) - scaling.input_mean) / scaling.input_scale

        def output(networks: Networks, k: int, features: Array = features) -> float:
            units = np.maximum(networks.hidden_weights[k] @ features + networks.hidden_biases[k], 0.0)
            return float(networks.output_weights[k, 0] @ units + networks.output_biases[k, 0])

        predictions = [output(members, k) for k in range(4)]
        noise = np.log1p(np.exp(output(ensemble.noise, 0))) + ensemble.floor
        variance = ensemble.model_share * np.var(predictions, ddof=1) + noise**2
        centre, spread = ensemble.centre_and_spread(sample[None])
        assert centre[0] == pytest.approx(1.0 + 0.3 * np.mean(predictions))
        assert spread[0] == pytest.approx(0.3 * np.sqrt(variance))


def test_few_members_count_for_more_than_their_variance() -> None:
    """t with nine degrees of freedom and √(1 + 1/B) in place of the normal quantile."""
    few = BootstrapEnsemble(**QUICK | {"epochs": 1}).fit(*table(4)).fitted_
    assert few.model_share == pytest.approx((2.262157 / 1.959964) ** 2 * 1.1, rel=1e-5)
    assert BootstrapEnsemble.paper(epochs=1, hidden=5).fit(*table(4)).fitted_.model_share == 1.0


def test_noise_is_learned_where_it_is() -> None:
    """A target of noise alone, ten times as loud on one side."""
    rng = np.random.default_rng(8)
    X = rng.uniform(-1.0, 1.0, size=(1800, 2))
    loud = X[:, 0] > 0.0
    y = np.where(loud, 1.0, 0.1) * rng.normal(size=len(X))
    settings = QUICK | {"epochs": 15, "calibration": "none", "members": 4}
    spread = BootstrapEnsemble(**settings).fit(X, y, np.repeat(np.arange(6), 300)).fitted_
    away = np.abs(X[:, 0]) > 0.3
    noise = spread.centre_and_spread(X)[1]
    assert noise[loud & away].mean() == pytest.approx(1.0, rel=0.25)
    assert noise[~loud & away].mean() < 0.4


def test_noise_is_no_less_than_a_thousandth_of_the_target() -> None:
    """By the paper's rules, and where every flight is learned to the last digit."""
    X, y, flights = table(4)
    assert BootstrapEnsemble.paper(epochs=1, hidden=5).fit(X, y, flights).fitted_.floor == pytest.approx(1e-3)
    rng = np.random.default_rng(0)
    line = rng.uniform(-1.0, 1.0, size=(600, 1))
    exact = BootstrapEnsemble(**QUICK | {"epochs": 60, "calibration": "none", "members": 3})
    assert exact.fit(line, line[:, 0], np.repeat(np.arange(20), 30)).fitted_.floor < 0.01


def test_noise_is_no_less_than_the_typical_offset_of_a_flight() -> None:
    """As for bounds (see `test_quality_driven`), without the quantile."""
    X, _, flights = table(5)
    y = np.where(flights % 2, 1.0, -1.0)
    settings = QUICK | {"epochs": 3, "calibration": "none"}
    fitted = BootstrapEnsemble(**settings).fit(X, y, flights).fitted_
    assert fitted.floor == pytest.approx(1.2 / 7.0**0.5, rel=0.1)
