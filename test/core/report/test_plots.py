# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from quadpi_core.report.plots import bins_within, extreme_samples


def test_keeps_every_peak_and_both_ends():
    x = np.sin(np.arange(100_000) / 3000)
    x[[137, 51_234]] = 40.0, -40.0
    kept = extreme_samples(x, x, bins=200)
    assert {0, 137, 51_234, 99_999} <= set(kept)
    assert len(kept) <= 402
    assert np.all(np.diff(kept) > 0)


def test_each_part_keeps_its_own_range():
    x = np.random.default_rng(0).standard_normal(10_000)
    kept = extreme_samples(x, x, bins=50)
    for start in range(0, 10_000, 200):
        part = kept[(kept >= start) & (kept < start + 200)]
        assert x[part].min() == x[start : start + 200].min()
        assert x[part].max() == x[start : start + 200].max()


def test_a_band_keeps_the_lowest_of_its_lower_and_the_highest_of_its_upper_bound():
    low, high = np.zeros(1000), np.ones(1000)
    low[301], high[702] = -5.0, 5.0
    assert {301, 702} <= set(extreme_samples(low, high, bins=10))


@pytest.mark.parametrize("size", [1, 2, 19, 20])
def test_a_short_series_stays_whole(size):
    x = np.zeros(size)
    assert extreme_samples(x, x, bins=10).tolist() == list(range(size))


@pytest.mark.parametrize(("lines", "bins"), [(0, 1000), (100, 1000), (500, 300), (2000, 150)])
def test_pages_of_many_lines_draw_fewer_samples_of_each(lines, bins):
    assert bins_within(lines) == bins
