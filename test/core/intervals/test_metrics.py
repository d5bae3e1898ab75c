# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy import stats

from quadpi_core.intervals import metrics

MEASURED = np.array([0.0, 1.0, 2.0, 5.0])
PREDICTED = np.array([0.0, 1.5, 2.0, 3.0])
LOWER = np.array([-1.0, 1.0, 2.5, 2.0])
UPPER = np.array([1.0, 2.0, 3.5, 4.0])


def test_coverage_counts_the_bounds_as_inside():
    assert metrics.picp(MEASURED, LOWER, UPPER) == 0.5


def test_width_and_its_share_of_the_training_range():
    assert metrics.mpiw(LOWER, UPPER) == 1.5
    assert metrics.nmpiw(LOWER, UPPER, training_range=10.0) == 0.15


def test_rmse_and_r_squared_by_hand():
    assert metrics.rmse(MEASURED, PREDICTED) == pytest.approx(np.sqrt(4.25 / 4))
    assert metrics.r_squared(MEASURED, PREDICTED) == pytest.approx(1 - 4.25 / 14.0)


def test_r_squared_of_a_constant_is_undefined():
    assert metrics.r_squared(np.full(5, 0.1), np.zeros(5)) is None


def test_winkler_adds_two_over_alpha_times_the_distance_outside():
    # Widths 2, 1, 1, 2; 0.5 below the third interval and 1 above the fourth; 2/α = 40 at 95 %.
    assert metrics.winkler(MEASURED, LOWER, UPPER, 0.95) == pytest.approx((6 + 40 * 1.5) / 4)


def test_winkler_is_best_for_the_true_quantiles():
    y = np.random.default_rng(0).standard_normal(20_000)
    half = stats.norm.ppf(0.975)

    def score(low, high):
        return metrics.winkler(y, np.full_like(y, low), np.full_like(y, high), 0.95)

    others = [
        score(-0.8 * half, 0.8 * half),
        score(-1.25 * half, 1.25 * half),
        score(-half + 0.5, half + 0.5),
    ]
    assert score(-half, half) < min(others)


@pytest.mark.parametrize("factor", [1e-3, 7.0, 1e4])
def test_metrics_scale_with_the_unit(factor):
    rng = np.random.default_rng(1)
    y, predicted = rng.standard_normal((2, 500))
    lower, upper = predicted - 1.0, predicted + 1.5
    scaled = [factor * value for value in (y, predicted, lower, upper)]
    assert metrics.picp(scaled[0], *scaled[2:]) == metrics.picp(y, lower, upper)
    assert metrics.mpiw(*scaled[2:]) == pytest.approx(factor * metrics.mpiw(lower, upper))
    assert metrics.rmse(*scaled[:2]) == pytest.approx(factor * metrics.rmse(y, predicted))
    assert metrics.r_squared(*scaled[:2]) == pytest.approx(metrics.r_squared(y, predicted))
    assert metrics.winkler(scaled[0], *scaled[2:], 0.9) == pytest.approx(
        factor * metrics.winkler(y, lower, upper, 0.9)
    )
