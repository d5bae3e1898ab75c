# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.frames import Array
from quadpi_core.models.envelope import PlacedErrors, SpreadShape, fit_shape, squared_speed


def errors(error: Array, leverage: Array, speed_squared: Array) -> PlacedErrors:
    return PlacedErrors(error, leverage, speed_squared, np.ones(len(error), dtype=bool))


@pytest.mark.parametrize(("inflation", "growth"), [(1.0, 0.5), (10.0, 0.05), (200.0, 1e-4), (200.0, 0.2)])
def test_known_shape_is_found(inflation: float, growth: float) -> None:
    rng = np.random.default_rng(1)
    shape, flights = SpreadShape(inflation, growth), []
    for fastest in (4.0, 8.0, 12.0, 6.0, 10.0):
        leverage = rng.exponential(0.05, size=4000)
        speed_squared = np.square(rng.uniform(0.0, fastest, size=4000))
        error = 0.3 * shape.of(leverage, speed_squared) * rng.normal(size=4000)
        flights.append(errors(error, leverage, speed_squared))
    found = fit_shape(flights, most_inflation=20_000)
    assert found.inflation == pytest.approx(inflation, rel=0.2, abs=1.0)
    assert found.growth == pytest.approx(growth, rel=0.2, abs=0.003)


def test_shape_stays_within_its_bounds() -> None:
    rng = np.random.default_rng(2)
    leverages = [rng.exponential(0.01, size=500) for _ in range(3)]
    still = np.zeros(500)
    falling = [errors(rng.normal(size=500) / (1.0 + 100.0 * h), h, still) for h in leverages]
    rising = [errors(rng.normal(size=500) * h, h, still) for h in leverages]
    assert fit_shape(falling, most_inflation=1500).inflation == pytest.approx(1.0, abs=0.01)
    assert fit_shape(rising, most_inflation=50).inflation == pytest.approx(50.0, rel=0.01)
    speeds = [rng.uniform(0.0, 100.0, size=500) for _ in range(3)]
    flat = [errors(rng.normal(size=500), np.zeros(500), speed) for speed in speeds]
    assert fit_shape(flat, most_inflation=50).growth * 100.0 < 0.3


def test_standstill_throughout_gives_a_finite_shape() -> None:
    rng = np.random.default_rng(3)
    hover = [errors(rng.normal(size=500), rng.exponential(0.01, size=500), np.zeros(500)) for _ in range(2)]
    shape = fit_shape(hover, most_inflation=1000)
    assert np.isfinite(shape.inflation)
    assert np.isfinite(shape.growth)


def test_no_errors_at_all_give_the_plain_shape() -> None:
    exact = [errors(np.zeros(5), np.full(5, 0.1), np.arange(5.0))]
    assert fit_shape(exact, most_inflation=5) == SpreadShape(1.0, 0.0)


def test_squared_airspeed_is_that_of_the_input_vector() -> None:
    inputs = np.arange(38.0).reshape(2, 19)
    np.testing.assert_allclose(squared_speed(inputs), [0 + 1 + 4, 19**2 + 20**2 + 21**2])


def test_variance_grows_with_airspeed_by_a_millionth_to_a_hundred_times() -> None:
    """On average over the flights; flights that hardly move leave it where it doubles at 0.1 m/s."""
    rng = np.random.default_rng(4)
    noise, exact = rng.normal(size=500), np.zeros(500)
    speed_squared = np.square(rng.uniform(0.0, 9.0, size=500))
    size = speed_squared.mean()
    moving = [errors(noise * np.sqrt(speed_squared), exact, speed_squared)]
    assert fit_shape(moving, most_inflation=5).growth * size == pytest.approx(100.0, rel=0.01)
    still = [errors(noise / (0.1 + speed_squared / size), exact, speed_squared)]
    assert fit_shape(still, most_inflation=5).growth * size == pytest.approx(1e-6, rel=0.01)
    hover = 1e-8 * speed_squared
    hardly = [errors(noise * np.sqrt(hover), exact, hover)]
    assert fit_shape(hardly, most_inflation=5).growth * 0.1**2 == pytest.approx(1.0, rel=0.01)
