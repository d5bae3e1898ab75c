# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from quadpi_core.evaluation.regimes import MOST_BINS, RegimeBins, by_bin, round_edges


@pytest.mark.parametrize(
    ("lowest", "highest", "edges"),
    [
        (0.02, 14.26, [0, 2, 4, 6, 8, 10, 12, 14, 16]),
        (0.0, 3.0, [0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5]),
        (-0.12, 0.2, [-0.15, -0.1, -0.05, 0, 0.05, 0.1, 0.15, 0.2, 0.25]),
        (812.0, 1790.0, [800, 1000, 1200, 1400, 1600, 1800]),
        (3.0, 3.0, [3.0, 3.1]),
    ],
)
def test_edges_are_round_numbers(lowest, highest, edges):
    assert round_edges(np.array([lowest, highest])).tolist() == edges


@pytest.mark.parametrize("seed", range(200))
def test_edges_span_any_values_in_few_equal_bins(seed):
    rng = np.random.default_rng(seed)
    values = 10.0 ** rng.uniform(-6, 6) * (rng.normal() * 3.0 + rng.random(50))
    edges = round_edges(values)
    assert edges[0] <= values.min()
    assert values.max() <= edges[-1]
    assert 2 <= len(edges) <= MOST_BINS + 1
    np.testing.assert_allclose(np.diff(edges), edges[1] - edges[0])


def test_bins_are_closed_below_and_null_where_empty():
    values, inside = np.array([0.0, 0.5, 1.0, 2.9]), np.array([True, False, True, True])
    bins = by_bin(values, inside, np.array([1.0, 3.0, 5.0, 7.0]), np.array([0.0, 1.0, 2.0, 3.0, 4.0]))
    assert bins == RegimeBins([2, 1, 1, 0], [0.5, 1.0, 1.0, None], [2.0, 5.0, 7.0, None])
