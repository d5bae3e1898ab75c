# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.rollout_calibration import (
    HORIZONS_S,
    TubeCalibration,
    error_norms,
)
from quadpi_core.models.tube_shape import EARLIER, QUANTITIES, TubeShape, tube_scores


@pytest.fixture(scope="module")
def errors():
    """Errors of three flights whose covariance is known, the last flight's twice as large."""
    rng = np.random.default_rng(1)
    axes = rng.uniform(0.1, 3.0, 12)
    covariance = np.tile(np.diag(axes**2), (400, len(HORIZONS_S), 1, 1))
    return covariance, [size * axes * rng.normal(size=(400, len(HORIZONS_S), 12)) for size in (1, 1, 2)]


@pytest.fixture(scope="module")
def calibration(errors):
    covariance, flights = errors
    return TubeCalibration.of_flights(
        [tube_scores(own, covariance) for own in flights], [error_norms(own) for own in flights]
    )


def test_scores_of_normal_errors_are_those_of_a_chi_distribution(errors) -> None:
    covariance, flights = errors
    # 95 % of three normal numbers lie within 2.7955 of their deviations.
    inside = tube_scores(flights[0], covariance) < 2.7955
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)
    assert tube_scores(flights[0], covariance).shape == (400, len(HORIZONS_S), len(QUANTITIES))


def test_the_factor_lies_in_the_middle_of_the_flights(calibration) -> None:
    factors = calibration.factors(HORIZONS_S, 0.95)
    # Geometric mean of 1, 1 and 2.
    np.testing.assert_allclose(factors, 2.7955 * 2.0 ** (1.0 / 3.0), rtol=0.1)
    assert np.all(calibration.factors(HORIZONS_S, 0.9) < factors)
    between = calibration.factors([0.07], 0.95)
    assert np.all((between >= factors.min() - 1e-9) & (between <= factors.max() + 1e-9))


@pytest.mark.parametrize("horizon", [0.001, 1.5])
def test_a_horizon_that_was_not_calibrated_is_refused(calibration, horizon) -> None:
    with pytest.raises(ModelError, match=r"calibrated from 0\.01 to 1 s"):
        calibration.radii([horizon], 0.95)


def test_a_stored_calibration_is_the_same_and_damage_is_refused(calibration) -> None:
    arrays = calibration.arrays()
    assert all(own.flags.c_contiguous for own in arrays.values())
    read = TubeCalibration.stored(arrays)
    np.testing.assert_array_equal(read.factors([0.1], 0.95), calibration.factors([0.1], 0.95))
    with pytest.raises(ModelError, match="scores"):
        TubeCalibration.stored({**arrays, "calibration_scores": -arrays["calibration_scores"]})
    with pytest.raises(ModelError, match="norms"):
        TubeCalibration.stored({**arrays, "calibration_norms": arrays["calibration_norms"][:, :2]})
    shape = {"calibration_shape": np.array([[0.0, 0.3, 0.6, 1.0], [1.0, 0.5, 0.0, 0.25]])}
    np.testing.assert_array_equal(
        TubeCalibration.stored({**arrays, **shape}).shape.size_power, [1, 0.5, 0, 0.25]
    )
    with pytest.raises(ModelError, match="shape of tubes"):
        TubeCalibration.stored({**arrays, "calibration_shape": 2.0 * shape["calibration_shape"]})


def test_a_calibration_of_an_earlier_version_keeps_its_shape(calibration) -> None:
    arrays = calibration.arrays()
    del arrays["calibration_shape"]
    read: TubeShape = TubeCalibration.stored(arrays).shape
    np.testing.assert_array_equal(read, EARLIER)
