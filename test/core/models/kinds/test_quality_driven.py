# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Quality-driven ensembles: how far bounds move outward, and the confidence that they are trained for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.random_ensembles import random_ensemble
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.kinds.quality_driven import FittedQualityDriven, QualityDriven

from ..small_fits import QUICK, REGRESSORS, axis_of, fit, interval, spread, table


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
