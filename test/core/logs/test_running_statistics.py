# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of values in parts are those of the whole, wherever it is cut."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadpi_core.logs.inspect import LongestRun, RunningRange


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 1)), min_size=1, max_size=14), st.data())
def test_the_longest_run_of_equal_rows_is_found_across_parts(rows, data):
    """By trying every run; of equally long ones the first."""
    values = np.array(rows, dtype=float)
    expected = max(
        (
            (first, last)
            for first in range(len(rows))
            for last in range(first, len(rows))
            if len(set(rows[first : last + 1])) == 1
        ),
        key=lambda run: (run[1] - run[0], -run[0]),
    )
    cuts = sorted(data.draw(st.lists(st.integers(0, len(rows)), max_size=4)))
    running = LongestRun()
    for part in np.split(values, cuts):
        running.add(part)
    assert running.longest() == expected


def test_a_range_passes_over_what_is_not_finite():
    running = RunningRange("speed", "m/s")
    running.add(np.array([np.nan, np.nan]))
    assert list(running.ranges()) == []
    for part in ([np.nan, 3.0], [], [-1.0, np.inf, 4.0], [2.0, 8.0]):
        running.add(np.array(part))
    (found,) = running.ranges()
    assert (found.quantity, found.unit) == ("speed", "m/s")
    assert (found.lowest, found.median, found.highest) == (-1.0, 3.0, 8.0)


def test_the_median_of_many_values_is_that_of_some_of_them():
    running, values = RunningRange("speed", "m/s"), np.random.default_rng(0).normal(size=100_000)
    for part in np.split(values, 100):
        running.add(part)
    (found,) = running.ranges()
    assert found.median == pytest.approx(0.0, abs=0.05)
    assert (found.lowest, found.highest) == (values.min(), values.max())
