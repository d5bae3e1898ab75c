# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What samples of drag need, and the pieces that intervals leave out."""

from __future__ import annotations

import pytest

from quadpi_core.field.airborne import flown
from quadpi_core.field.drag import drag_samples, piece_lengths_s

from .field_examples import example


@pytest.mark.parametrize("lacking", ["imu", "attitude"])
def test_what_the_log_lacks_is_named(lacking):
    said = drag_samples(example(**{lacking: None}), flown(example()), 5.0)
    assert said == f"the log has no {'specific force' if lacking == 'imu' else lacking}"


def test_an_hour_is_cut_into_as_many_pieces_as_ten_minutes():
    assert piece_lengths_s([600.0]) == pytest.approx([10.0])
    assert piece_lengths_s([1800.0] * 2) == pytest.approx([60.0] * 2)
    assert piece_lengths_s([20.0]) == pytest.approx([3.0])
    assert piece_lengths_s([60.0] * 5) == pytest.approx([6.0] * 5)
