# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""An effect may enlarge one axis by less than it takes from all."""

from __future__ import annotations

import numpy as np

from quadpi_core.discrepancy.acceptance import judge_left_out

SQUARES = np.full(6, 100.0)


def first_axis(value, others=0.0):
    return np.array([value, *[others] * 5])


def test_what_an_effect_takes_from_one_axis_may_return_in_another():
    """Coefficients settle elsewhere beside a true effect."""
    after = SQUARES + first_axis(200.0, -80.0)
    assert judge_left_out(SQUARES, after, 10).passed == (200.0 <= 0.5 * (100.0 + 200.0))
    assert judge_left_out(SQUARES, SQUARES + first_axis(140.0, -80.0), 10).passed
