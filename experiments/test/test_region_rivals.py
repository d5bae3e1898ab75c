# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The race of regions: every rule on flights that are made, and the result."""

from __future__ import annotations

import numpy as np
import pytest
from interval_rivals import Race
from region_rivals import REGIONS, Regions, region_result
from scipy.signal import lfilter

RATE_HZ, SAMPLES, FLIGHTS = 50.0, 1200, 8


@pytest.fixture(scope="module")
def race() -> Race:
    """Errors that last, two axes of which go together, of flights left out in four turns."""
    random, keep = np.random.default_rng(0), np.exp(-1.0 / (0.3 * RATE_HZ))
    noise = random.standard_normal((SAMPLES, FLIGHTS, 6))
    noise[..., 1] = 0.95 * noise[..., 0] + 0.3 * noise[..., 1]
    error = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], noise, axis=0)
    error[-100:, 0] = np.nan
    speed = random.uniform(0.0, 5.0, (SAMPLES, FLIGHTS))
    return Race(error, np.full(error.shape, 2.0), speed, np.arange(FLIGHTS) % 4, RATE_HZ, 1)


@pytest.mark.parametrize("name", REGIONS)
def test_region_covers_flights_left_out(name: str, race: Race) -> None:
    coverage = region_result(REGIONS[name](race), 100).coverage
    assert np.mean(coverage) == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize("name", REGIONS)
def test_region_knows_neither_the_future_nor_the_present(name: str, race: Race) -> None:
    changed = race.error.copy()
    changed[1000:, 3] += 50.0
    said, other = (
        REGIONS[name](Race(error, race.half, race.speed, race.turn, RATE_HZ, 1))
        for error in (race.error, changed)
    )
    for before, after in zip((said.radius, said.unit), (other.radius, other.unit), strict=True):
        np.testing.assert_array_equal(before[:1001, 3], after[:1001, 3])


def test_an_ellipsoid_is_narrower_where_axes_go_together(race: Race) -> None:
    box, ellipsoid = (
        np.mean(region_result(REGIONS[name](race), 100).width)
        for name in ("box of split conformal", "conformal ellipsoid")
    )
    assert ellipsoid < 0.85 * box


def test_a_width_is_the_side_of_a_cube_and_a_window_its_least_coverage() -> None:
    size = np.array([[0.5, 1.5, 0.5, 0.5]]).T
    found = region_result(Regions(size, np.ones_like(size), np.full_like(size, np.log(2.0))), 2)
    assert (found.width[0], found.coverage[0], found.worst[0]) == pytest.approx((2.0, 0.75, 0.5))
