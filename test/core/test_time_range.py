# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of flights by time, as `--from` and `--to` ask for them."""

import math

import pytest

from quadpi_core.errors import QuadpiError
from quadpi_core.reading_options import WHOLE, TimeRange


@pytest.mark.parametrize("ends", [(2.0, 1.0), (2.0, 2.0), (-1.0, 2.0), (math.nan, 2.0), (1.0, math.nan)])
def test_a_range_that_is_none_is_refused(ends):
    with pytest.raises(QuadpiError, match="no range of seconds since the first IMU sample"):
        TimeRange(*ends)


def test_stamps_count_from_the_first_imu_sample():
    assert TimeRange(1.5, 2.0).stamps(10) == (1_500_000_010, 2_000_000_010)
    first, last = TimeRange(to_s=1.0).stamps(10**9)
    assert (first < 0, last) == (True, 2 * 10**9)
    assert WHOLE.is_whole
    assert str(TimeRange(1.5)) == "from 1.5 s to its end"
