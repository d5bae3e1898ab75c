# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns in frequency, their products, and the noise that their fit leaves in each band."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from quadpi_core.discrepancy.whitening import (
    Noise,
    PairsOfColumns,
    Part,
    band_means,
    estimate_noise,
    settled_noise,
    spectrum,
    taper,
)

from .dense_noise import BANDS, ROWS, covariance, deviating, random_columns, random_noise, told


def test_rows_keep_squares_and_the_variance_of_white_noise():
    """Below half the rate all is compared: rows are orthogonal combinations of samples, but for the taper."""
    samples = 301
    each = np.repeat(np.eye(samples)[:, None], 6, axis=1)
    seen, weights = spectrum(each, 30.0).rows, taper(samples, 30.0)
    faded = samples * np.square(weights) / np.square(weights).sum()
    np.testing.assert_allclose(seen[2].T @ seen[2], np.diag(faded), atol=1e-12)
    np.testing.assert_allclose(np.square(seen[2]).sum(axis=1), 1.0, atol=0.07)
    # Half a cosine at either end, and half of a flight at least as it is.
    assert np.all(weights[15:-15] == 1.0)
    np.testing.assert_allclose(weights[:15] + weights[14::-1], 1.0)
    np.testing.assert_array_equal(weights, weights[::-1])
    assert np.sum(taper(40, 100.0) == 1.0) == 20


def test_a_tone_is_where_its_frequency_is_and_nothing_above_the_highest_is_seen():
    time = np.arange(5000) / 100.0
    tone = np.tile(np.sin(2.0 * np.pi * 6.0 * time)[:, None, None], (1, 6, 1))
    seen, fast = spectrum(tone, 100.0), spectrum(tone, 400.0)
    squares = np.square(seen.rows[0, :, 0])
    # Real and imaginary part of the frequency of row 2 k − 1 and 2 k are next to each other.
    assert squares[599:601].sum() > 0.9 * squares.sum()
    # Between 5 and 8 Hz.
    assert np.bincount(seen.band, squares)[6] > 0.999 * squares.sum()
    # Of 50 s up to 20 Hz, and of 12.5 s, in which it is one of 24 Hz.
    assert [own.rows.shape for own in (seen, fast)] == [(6, 2 * 1000 + 1, 1), (6, 2 * 250 + 1, 1)]
    assert np.square(fast.rows[0]).sum() < 1e-3 * squares.sum()


def test_means_of_a_band_are_over_all_flights():
    values = [np.array([[1.0, 2.0, 4.0]]), np.array([[6.0, 8.0]])]
    bands = [np.array([0, 0, 2]), np.array([0, 2])]
    np.testing.assert_allclose(band_means(values, bands), [[3.0, 0.0, 6.0]])


def test_products_of_a_band_are_those_of_its_rows():
    rng = np.random.default_rng(0)
    one, two = random_columns(rng, 3), random_columns(rng, 2)
    products = one.products(two)
    assert products.shape == (2, 6, BANDS, 3, 2)
    for place, own in enumerate(ROWS):
        for band in range(BANDS):
            first, second = (columns.spectra[place].rows[:, own == band] for columns in (one, two))
            expected = np.einsum("abi,abj->aij", first, second)
            np.testing.assert_allclose(products[place, :, band], expected, atol=1e-12)


def test_what_was_made_of_two_columns_is_kept_as_long_as_both_are():
    rng, made = np.random.default_rng(2), []

    def product(first, second):
        made.append(first.products(second))
        return made[-1]

    one, two, pairs = random_columns(rng, 3), random_columns(rng, 2), PairsOfColumns(product)
    assert pairs(one, two) is pairs(one, two)
    np.testing.assert_array_equal(pairs(two, one), np.swapaxes(pairs(one, two), -1, -2))
    assert len(made) == 1
    kept = weakref.ref(made.pop())
    del two
    gc.collect()
    assert kept() is None


def test_what_flights_have_of_their_own_is_a_part_of_the_noise():
    """Products are weighed by the inverse of its covariance, each flight by its own."""
    rng = np.random.default_rng(3)
    noise, one, two = random_noise(rng), random_columns(rng, 3), random_columns(rng, 2)
    parts = [Part(one, rng.standard_normal(3)), Part(two, rng.standard_normal(2))]
    cost = 0.0
    for place, band in enumerate(ROWS):
        inverse = np.linalg.inv(covariance(noise, one, place))
        both = np.hstack((told(one, place), told(two, place)))
        gram = noise.grams((one, two), (two,))[place]
        np.testing.assert_allclose(gram, both.T @ inverse @ told(two, place), atol=1e-12)
        residual = both @ np.concatenate([part.weights for part in parts])
        assert noise.squares(parts, place) == pytest.approx(residual @ inverse @ residual)
        # The posterior of standard normal z of a residual that is z of these deviations and white noise.
        own = deviating(noise, place)
        mean = own.T @ inverse @ residual
        np.testing.assert_allclose(noise.deviations(parts, place), mean, atol=1e-12)
        np.testing.assert_allclose(noise.covariance[place], np.eye(3) - own.T @ inverse @ own, atol=1e-12)
        np.testing.assert_allclose(noise.own_rows(parts, place).ravel(), own @ mean, atol=1e-12)
        white = np.log(noise.variance[place][:, band]).sum()
        cost += 0.5 * (np.linalg.slogdet(covariance(noise, one, place))[1] - white)
    assert noise.cost == pytest.approx(cost)
    alone = Noise(noise.variance)
    assert (alone.cost, alone.own_rows(parts, 0).any()) == (0.0, False)


BAND = np.repeat(np.arange(BANDS), 120)
ONES, ANY, COUNTS = np.ones((6, BANDS)), np.full((6, BANDS), np.inf), np.bincount(BAND)


def noisy(width, deviation):
    """Rows (6, B, 1 + width) of a residual and columns that explain it but for noise of a deviation (6, C).

    Beside them are their products by band.
    """
    rng = np.random.default_rng(0)
    columns = random_columns(rng, 1 + width, (BAND,))
    rows = columns.spectra[0].rows
    rows[:, :, 0] = deviation[:, BAND] * rows[:, :, 0] + rows[:, :, 1:] @ rng.standard_normal(width)
    return rows, columns.products(columns)[0]


@pytest.mark.parametrize("penalty", [1.0, 300.0])
def test_settled_noise_is_the_squares_after_the_fit_and_the_variance_of_the_fit(penalty):
    """Where the rounds end they change nothing any more; a prior is a penalty of one."""
    rows, products = noisy(5, 0.5 * ONES)
    noise = settled_noise(products, COUNTS, ONES, lambda gram: penalty * np.eye(len(gram)))
    if penalty == 1.0:
        np.testing.assert_allclose(estimate_noise(products, COUNTS, ANY), noise, rtol=1e-6)
    white = np.concatenate(rows / np.sqrt(noise[:, BAND, None]))
    open_ = np.linalg.inv(white[:, 1:].T @ white[:, 1:] + penalty * np.eye(5))
    left = rows[:, :, 0] - rows[:, :, 1:] @ open_ @ white[:, 1:].T @ white[:, 0]
    squares = np.square(left) + np.sum(rows[:, :, 1:] @ open_ * rows[:, :, 1:], axis=2)
    np.testing.assert_allclose(noise, band_means([squares], [BAND]), rtol=1e-4)


def test_noise_is_found_however_many_columns_explain_it():
    """A third as many as there are rows in each axis; each axis and band has noise of its own."""
    deviation = np.linspace(0.5, 2.0, 18).reshape(6, BANDS)
    _, products = noisy(120, deviation)
    found = estimate_noise(products, COUNTS, ANY)
    np.testing.assert_allclose(np.sqrt(found), deviation, rtol=0.25)
    assert np.mean(found / deviation**2) == pytest.approx(1.0, abs=0.04)


def test_a_band_that_no_flight_reaches_has_the_noise_of_the_next():
    _, products = noisy(2, np.array([[1.0, 2.0, 3.0]] * 6))
    products[:, 0] = 0.0
    found = estimate_noise(products, np.where(np.arange(BANDS) > 0, COUNTS, 0), ANY)
    np.testing.assert_array_equal(found[:, 0], found[:, 1])
    assert np.all(found[:, 2] > found[:, 1])


def test_noise_is_no_more_than_what_it_may_be_and_can_be_divided_by():
    _, products = noisy(3, ONES)
    free, most = estimate_noise(products, COUNTS, ANY), ANY.copy()
    most[2] = 0.01
    bound, others = estimate_noise(products, COUNTS, most), np.arange(6) != 2
    np.testing.assert_array_equal(bound[2], 0.01)
    np.testing.assert_allclose(bound[others], free[others], rtol=0.1)
    nothing = estimate_noise(0.0 * products, COUNTS, ANY)
    assert np.all(np.isfinite(1.0 / np.sqrt(nothing)))
