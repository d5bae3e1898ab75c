# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The race of tubes: every rule on errors ahead that are made, and the rows of the table."""

from __future__ import annotations

import numpy as np
import pytest
from interval_rivals import Race
from region_rivals import Regions, ball_width, region_result
from tube_rivals import FIRST, PAGE, TURNS, Ahead, regions_of, rows, side_by_side

FLIGHTS, STARTS, RATE_HZ = 8, 600, 10.0


@pytest.fixture(scope="module")
def own() -> Ahead:
    """Errors of three axes of which one is large, and tubes that know which."""
    random, spread = np.random.default_rng(4), np.array([1.0, 1.0, 8.0])
    error = spread * random.standard_normal((STARTS, FLIGHTS, 3))
    race = Race(error, np.ones_like(error), np.zeros(error.shape[:2]), np.arange(FLIGHTS) % TURNS, RATE_HZ, 1)
    size = np.sqrt(np.square(error / spread).sum(axis=-1))
    # The square of 2.795 is the quantile of 95 % of chi-square with three degrees of freedom.
    unit = np.full_like(size, np.log(spread).mean() + ball_width(3))
    return Ahead(race, Regions(size, np.full_like(size, 2.795), unit))


def test_every_region_covers_flights_left_out(own: Ahead) -> None:
    for name, regions in regions_of(own).items():
        assert np.mean(region_result(regions, 20).coverage) == pytest.approx(0.95, abs=0.015), name


def test_what_knows_the_large_axis_is_narrower_than_a_ball(own: Ahead) -> None:
    table = {row[0]: row[1] for row in rows({"a set": [own]})}
    assert table[FIRST] == 1.0
    assert table["tubes"] == pytest.approx(table["conformal ellipsoid"], rel=0.03)
    assert table["tubes"] < 0.5


def test_a_ball_of_radius_one_is_as_wide_as_a_cube_of_its_volume() -> None:
    assert np.exp(ball_width(3)) ** 3 == pytest.approx(4.0 / 3.0 * np.pi)


def test_flights_of_other_lengths_end_in_nan() -> None:
    both = side_by_side([np.ones((3, 2)), np.zeros((1, 2))])
    assert both.shape == (3, 2, 2)
    assert np.isnan(both[1:, 1]).all()
    assert np.isfinite(both[:, 0]).all()


def test_the_page_has_a_place_for_the_table() -> None:
    assert PAGE.read_text().count("<!-- table: regions -->") == 1
