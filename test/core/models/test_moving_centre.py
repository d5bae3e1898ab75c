# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The regression of errors on running means of those before, and how a model keeps it."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.interval_rules import (
    MEMORIES_S,
    MovedAxis,
    MovingCentre,
    delayed,
    means_of,
    regressed,
)


def means_and_errors(count, slope):
    means = np.zeros((count, len(MEMORIES_S)))
    means[:, 0] = np.random.default_rng(count).standard_normal(count)
    return slope * means[:, 0], means


def test_each_flight_counts_the_same_however_long():
    flights = [means_and_errors(count, slope) for count, slope in ((100, 0.9), (10_000, 1.0), (101, 0.9))]
    coefficients, moves = regressed(flights)
    assert coefficients[0] == pytest.approx(2.8 / 3.0, abs=0.02)
    np.testing.assert_allclose(moves[1], 0.9 * flights[1][1][:, 0], rtol=0.01)


def test_what_does_not_repeat_itself_from_flight_to_flight_moves_nothing():
    coefficients, moves = regressed(
        [means_and_errors(count, slope) for count, slope in ((100, 1.0), (99, -1.0))]
    )
    assert not np.any(coefficients)
    assert not np.any(np.concatenate(moves))


def test_running_means_of_errors_that_are_known():
    known = delayed(np.array([1.0, np.nan, 3.0, 4.0]), 2)
    np.testing.assert_array_equal(known, [0.0, 0.0, 1.0, 0.0])
    means = means_of(known, 50.0)
    share = 1.0 - np.exp(-1.0 / (np.array(MEMORIES_S) * 50.0))
    np.testing.assert_allclose(
        means, np.outer([0.0, 0.0, 1.0, 0.0], share) + np.outer([0, 0, 0, 1.0], share * (1 - share))
    )


def test_numbers_for_the_model_file():
    stored = MovingCentre({"Fx": MovedAxis(np.arange(8.0), 0.5)}).to_json()
    assert MovingCentre.from_json(stored).to_json() == stored
    stored["axes"]["Fx"]["coefficients"] = [1.0]
    with pytest.raises(ModelError, match=r"moving centre: .*8 numbers"):
        MovingCentre.from_json(stored)
