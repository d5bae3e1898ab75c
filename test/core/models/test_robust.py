# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.gram import Gram
from quadpi_core.models.robust import TUNING, huber
from quadpi_core.models.selection import fit_coefficients

TRUE = np.array([2.0, -1.0, 0.5])
NOISE = 0.1


@pytest.fixture
def samples():
    rng = np.random.default_rng(0)
    Z = np.column_stack((np.ones(20_000), rng.normal(size=(20_000, 2))))
    return Z, Z @ TRUE + rng.normal(0.0, NOISE, len(Z))


def least_squares(Z, y):
    return fit_coefficients(Gram(Z.T @ Z, Z.T @ y, float(y @ y), len(y)), [0, 1, 2])


def test_without_wild_samples_it_is_least_squares_bit_for_bit(samples):
    Z, y = samples
    plain = least_squares(Z, y)
    for robust, least in zip(huber(Z, y, *plain), plain, strict=True):
        np.testing.assert_array_equal(robust, least)


@pytest.mark.parametrize("size", [1e2, 1e4])
def test_wild_samples_pull_no_more_than_the_bound(samples, size):
    """200 of 20 000 samples, all wild in one direction where the regressors are large."""
    Z, y = samples
    wild = np.argsort(Z[:, 1])[-200:]
    spoilt = y.copy()
    spoilt[wild] += size
    robust, _ = huber(Z, spoilt, *least_squares(Z, spoilt))
    plain, _ = least_squares(Z, spoilt)
    pull = np.linalg.norm(Z[wild], axis=1).sum() * TUNING * NOISE / len(y)
    assert np.abs(robust - TRUE).max() < 1.5 * pull
    assert np.abs(plain - TRUE).max() > 10.0 * pull


def test_an_exact_fit_has_no_scale(samples):
    Z, _ = samples
    exact = Z @ TRUE
    coefficients, _ = huber(Z, exact, TRUE, np.eye(3))
    np.testing.assert_array_equal(coefficients, TRUE)


def test_terms_that_only_wild_samples_tell_apart_are_refused(samples):
    Z, y = samples
    alike, spoilt = Z[:, [0, 1, 1]].copy(), y.copy()
    alike[:2, 2] += 1e-3
    spoilt[:2] += (1e12, -1e12)
    with pytest.raises(ModelError, match=r"differ in wild samples alone, with residuals up to 1e\+12"):
        huber(alike, spoilt, np.zeros(3), np.eye(3))
