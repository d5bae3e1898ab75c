# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Residuals of flights: coefficients fitted within tolerances, and rows in frequency as series in time."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.discrepancy.residual_bins import (
    bin_edges,
    largest_deviation,
    over_time,
    sample_indices,
    within_tolerance,
)
from quadpi_core.discrepancy.whitening import spectrum


def test_coefficients_within_tolerance_explain_what_they_can_and_no_more():
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((200, 4)) * 30.0
    most = largest_deviation(4)
    assert 2.0 < most < 3.5
    truth = np.array([[0.5, 0.5], [-1.0, -1.0], [0.2, 0.2], [1.0, 9.0]])
    gram = columns.T @ columns
    inside, outside = within_tolerance(gram, gram @ truth).T
    assert inside == pytest.approx(truth[:, 0], abs=0.01)
    assert outside[3] == most
    assert np.abs(outside).max() <= most


@pytest.mark.parametrize("samples", [1000, 1001])
def test_rows_come_back_as_the_signal_that_they_were_made_of(samples):
    """Within the band and away from the ends, that rise and fall; and squares stay the same."""
    rate_hz = 125.0
    time = np.arange(samples) / rate_hz
    signal = np.sin(2.0 * np.pi * 3.0 * time + 0.4) + 0.5
    columns = np.repeat((signal[:, None] * np.arange(1.0, 7.0))[:, :, None], 2, axis=2)
    rows = spectrum(columns, rate_hz).rows
    series = over_time(rows, samples)
    at = sample_indices(rows.shape[1], samples)
    assert series.shape == (len(at), 6, 2)
    assert np.square(series).mean(axis=0) == pytest.approx(np.square(rows).sum(axis=1) / samples)
    inner = (time[at] > 1.0) & (time[at] < time[-1] - 1.0)
    # The taper takes a little of the whole, which the scale gives back.
    fitted = series[inner, 0, 0] @ signal[at][inner] / (signal[at][inner] @ signal[at][inner])
    assert 1.0 < fitted < 1.1
    assert series[inner, 0, 0] == pytest.approx(fitted * signal[at][inner], abs=0.08)


def test_bins_of_the_height_grow_with_it():
    """The air near the ground changes with powers of the height."""
    heights = np.concatenate([np.full(100, value) for value in (0.05, 0.15, 0.3, 0.7, 1.5, 3.0, 7.0, 15.0)])
    assert bin_edges("height", heights).tolist() == [0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0]
    high = np.concatenate([np.full(100, value) for value in (30.0, 70.0, 200.0)])
    assert bin_edges("height", high).tolist() == [0.0, 50.0, 100.0, 200.0]
