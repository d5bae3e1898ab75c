# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Quality-driven ensembles: bounds that move outward, and the confidence that they are trained for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.random_ensembles import random_ensemble
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.kinds.quality_driven import KIND, QualityDrivenEnsemble
from quadpi_core.models.model_kind import IdentifyOptions

from ..small_ensembles import QUICK, REGRESSORS, table


def test_quality_driven_bounds_move_outward(X: Array) -> None:
    ensemble = random_ensemble("quality-driven", X, REGRESSORS, members=4, units=5)
    bounds = ensemble.members.outputs(ensemble.features(X))
    outward = 1.96 * bounds.std(axis=0, ddof=1).mean(axis=1)
    lower, upper = bounds.mean(axis=0).T + outward * [[-1.0], [1.0]]
    assert np.all(lower < upper)
    centre, spread = ensemble.centre_and_spread(X)
    np.testing.assert_allclose(centre - spread, 1.0 + 0.3 * lower)
    np.testing.assert_allclose(centre + spread, 1.0 + 0.3 * upper)


@pytest.mark.parametrize("distance", [-3.0, 0.0])
def test_bounds_that_cross_or_meet_still_hold_an_interval(X: Array, distance: float) -> None:
    ensemble = random_ensemble("quality-driven", X, REGRESSORS, members=4, units=5)
    members = replace(
        ensemble.members,
        output_weights=np.repeat(ensemble.members.output_weights[:, :1], 2, axis=1),
        output_biases=np.tile([0.0, distance], (4, 1)),
    )
    _, spread = replace(ensemble, members=members, outward=0.0).centre_and_spread(X)
    np.testing.assert_allclose(spread, 0.3 * max(0.5 * abs(distance), ensemble.floor))


def test_bounds_of_the_paper_are_for_the_confidence_of_training() -> None:
    X, y, flights = table(4)
    ensemble = QualityDrivenEnsemble.paper(epochs=2, confidence=0.9).fit(X, y, flights)
    ensemble.predict_interval(X, 0.9)
    with pytest.raises(ModelError, match=r"trained for a confidence of 0\.9, not 0\.95"):
        ensemble.predict_interval(X, 0.95)


def test_the_paper_moves_bounds_by_the_error_of_the_mean() -> None:
    """Of ten members the standard deviation over √10; the default takes the deviation itself."""
    X, y, flights = table(4)
    paper = QualityDrivenEnsemble.paper(epochs=1, hidden=5).fit(X, y, flights).fitted_
    default = QualityDrivenEnsemble(**QUICK | {"epochs": 1, "calibration": "none"}).fit(X, y, flights).fitted_
    assert paper.outward == pytest.approx(1.959964 / 10**0.5, rel=1e-6)
    assert default.outward == pytest.approx(1.959964, rel=1e-6)
    assert default.deviation_weight == default.outward


def test_half_distance_is_no_less_than_the_typical_offset_of_a_flight() -> None:
    """Flights alternate between -1 and 1, which no input tells.

    The middle of a member without one of six lies from 0 to 0.2 the other way, so it is off by 1 to 1.2. As
    a seventh flight counts with ordinary errors, the floor is 1.96 / √7 of that.
    """
    X, _, flights = table(5)
    y = np.where(flights % 2, 1.0, -1.0)
    settings = QUICK | {"epochs": 3, "calibration": "none"}
    fitted = QualityDrivenEnsemble(**settings).fit(X, y, flights).fitted_
    assert fitted.floor == pytest.approx(1.96 * 1.1 / 7.0**0.5, rel=0.12)
    assert np.all(fitted.centre_and_spread(X)[1] >= 0.999 * fitted.floor * fitted.scaling.target_scale)


def test_bounds_are_trained_for_the_confidence_that_is_asked_for() -> None:
    for level in (0.9, 0.99):
        estimator = KIND.configured(REGRESSORS, IdentifyOptions(method=KIND.name, confidence=level))
        assert estimator.get_params()["confidence"] == level
