# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns in frequency, and the noise that their fit leaves in each band."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.discrepancy.whitening import (
    Spectrum,
    band_means,
    band_products,
    cross_gram,
    estimate_noise,
    settled_noise,
    spectrum,
    taper,
)

RATE_HZ = 30.0
BANDS = 3


def noisy_spectra(columns, deviation, flights=4, rows=90, seed=0):
    """Spectra whose residual is noise of a deviation (6, C) and a sum of columns; each band a third."""
    rng = np.random.default_rng(seed)
    band = np.arange(rows) % BANDS
    weights = rng.standard_normal(columns)
    made = []
    for _ in range(flights):
        table = rng.standard_normal((6, rows, columns))
        residual = table @ weights + deviation[:, band] * rng.standard_normal((6, rows))
        made.append(Spectrum(np.concatenate((residual[:, :, None], table), axis=2), band))
    return made


def times(factor):
    """A penalty."""
    return lambda gram: factor * np.eye(len(gram))


def test_squares_stay_as_they_are_under_the_taper():
    """Parseval: below half the rate everything is compared, and a constant has its samples as squares."""
    samples = 301
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((samples, 6, 2))
    rows = spectrum(columns, RATE_HZ).rows
    faded = columns * taper(samples, RATE_HZ)[:, None, None]
    expected = samples * np.square(faded).sum(axis=0) / np.square(taper(samples, RATE_HZ)).sum()
    np.testing.assert_allclose(np.square(rows).sum(axis=1), expected, rtol=1e-12)


def test_white_noise_keeps_its_variance_in_every_row():
    noise = 0.3 * np.random.default_rng(1).standard_normal((2000, 6, 50))
    rows = spectrum(noise, 100.0).rows
    by_band = band_means([np.square(rows).mean(axis=2)], [spectrum(noise, 100.0).band])
    np.testing.assert_allclose(by_band.mean(axis=0), 0.09, rtol=0.06)


def test_a_tone_is_where_its_frequency_is_and_nothing_above_the_highest_is_seen():
    time = np.arange(5000) / 100.0
    tone = np.tile(np.sin(2.0 * np.pi * 6.0 * time)[:, None, None], (1, 6, 1))
    seen = spectrum(tone, 100.0)
    squares = np.bincount(seen.band, np.square(seen.rows[0, :, 0]))
    # Between 5 and 8 Hz.
    assert np.argmax(squares) == 6
    assert squares[6] > 0.999 * squares.sum()
    slow = spectrum(tone, 100.0, highest_hz=5.0)
    assert slow.band.max() == 5
    assert slow.rows.shape[1] == 2 * 250 + 1
    assert np.square(slow.rows[0]).sum() < 1e-3 * squares.sum()
    # What is compared is split at the same edges.
    np.testing.assert_array_equal(slow.band[:250], seen.band[:250])


def test_a_taper_rises_as_half_a_cosine_at_either_end():
    weights = taper(400, 100.0)
    np.testing.assert_array_equal(weights, weights[::-1])
    assert np.all(weights[50:350] == 1.0)
    assert weights[:2] + weights[48:50][::-1] == pytest.approx([1.0, 1.0])
    # Half of a flight at least is seen in full.
    assert np.sum(taper(40, 100.0) == 1.0) == 20


def test_products_are_summed_over_axes_and_rows():
    rng = np.random.default_rng(2)
    first, second = rng.standard_normal((6, 20, 3)), rng.standard_normal((6, 20, 2))
    np.testing.assert_allclose(cross_gram(first, second), np.einsum("abi,abj->ij", first, second))


def test_products_of_a_band_are_those_of_its_rows_in_all_flights():
    spectra = noisy_spectra(2, np.ones((6, BANDS)))
    products = band_products(spectra)
    for band in range(BANDS):
        rows = [flight.rows[:, flight.band == band] for flight in spectra]
        expected = sum(np.einsum("ani,anj->aij", own, own) for own in rows)
        np.testing.assert_allclose(products[:, band], expected, atol=1e-10)


def test_settled_noise_is_the_squares_after_the_fit_and_the_variance_of_the_fit():
    """Where the rounds end they change nothing any more."""
    spectra = noisy_spectra(5, np.full((6, BANDS), 0.5))
    noise = estimate_noise(spectra)
    whitened = [own.rows / np.sqrt(noise[:, own.band])[:, :, None] for own in spectra]
    gram = sum(cross_gram(rows, rows) for rows in whitened)
    covariance = np.linalg.inv(gram[1:, 1:] + np.eye(5))
    fit = covariance @ gram[1:, 0]
    expected = [
        np.square(own.rows[:, :, 0] - own.rows[:, :, 1:] @ fit)
        + np.einsum("abi,ij,abj->ab", own.rows[:, :, 1:], covariance, own.rows[:, :, 1:])
        for own in spectra
    ]
    np.testing.assert_allclose(noise, band_means(expected, [own.band for own in spectra]), rtol=1e-4)


def test_means_of_a_band_are_over_all_flights():
    values = [np.array([[1.0, 2.0, 4.0]]), np.array([[6.0, 8.0]])]
    bands = [np.array([0, 0, 2]), np.array([0, 2])]
    np.testing.assert_allclose(band_means(values, bands), [[3.0, 0.0, 6.0]])


def test_noise_is_found_however_many_columns_explain_it():
    """Forty columns for four flights of 540 rows; each axis and band has noise of its own."""
    deviation = np.linspace(0.5, 2.0, 18).reshape(6, BANDS)
    found = estimate_noise(noisy_spectra(40, deviation, flights=6))
    assert found.shape == (6, BANDS)
    np.testing.assert_allclose(np.sqrt(found), deviation, rtol=0.2)
    assert np.mean(found / deviation**2) == pytest.approx(1.0, abs=0.05)


def test_many_columns_do_not_make_the_noise_look_small():
    """With half as many columns as rows a fit leaves half of the squares; true noise stays as it is."""
    found = []
    for seed in range(8):
        spectra = noisy_spectra(60, np.ones((6, BANDS)), rows=30, seed=seed)
        alone = [Spectrum(own.rows[:1], own.band) for own in spectra]
        found.append(settled_noise(alone, band_products(alone), np.ones((1, BANDS)), times(1.0)).mean())
    assert np.mean(found) == pytest.approx(1.0, abs=0.15)


def test_a_band_that_no_flight_reaches_has_the_noise_of_the_next():
    deviation = np.array([[1.0, 2.0, 3.0]] * 6)
    spectra = [
        Spectrum(flight.rows[:, flight.band > 0], flight.band[flight.band > 0])
        for flight in noisy_spectra(2, deviation)
    ]
    found = estimate_noise(spectra)
    np.testing.assert_array_equal(found[:, 0], found[:, 1])
    assert np.all(found[:, 2] > found[:, 1])


def test_noise_is_no_more_than_what_it_may_be():
    spectra = noisy_spectra(3, np.ones((6, BANDS)))
    most = np.ones((6, BANDS))
    most[2] = 0.01
    found = estimate_noise(spectra, most)
    np.testing.assert_allclose(found[2], 0.01)
    np.testing.assert_allclose(
        found[[0, 1, 3, 4, 5]], np.minimum(estimate_noise(spectra)[[0, 1, 3, 4, 5]], 1.0), rtol=0.05
    )


def test_a_penalty_keeps_columns_from_explaining_noise():
    spectra = noisy_spectra(3, np.ones((6, BANDS)))
    start = np.ones((6, BANDS))
    free = settled_noise(spectra, band_products(spectra), start, times(1e-9))
    bound = settled_noise(spectra, band_products(spectra), start, times(1e9))
    np.testing.assert_allclose(free, 1.0, atol=0.35)
    squares = band_means([np.square(own.rows[:, :, 0]) for own in spectra], [own.band for own in spectra])
    np.testing.assert_allclose(bound, squares, rtol=1e-3)


def test_a_residual_of_nothing_has_a_noise_that_can_be_divided_by():
    spectra = [Spectrum(np.zeros((6, 9, 2)), np.arange(9) % BANDS)] * 2
    noise = estimate_noise(spectra)
    assert np.all(noise > 0.0)
    assert np.all(np.isfinite(1.0 / np.sqrt(noise)))
