# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.frames import Array
from quadpi_core.models.leverage import LeveragedErrors, fit_inflation


def errors(error: Array, leverage: Array) -> LeveragedErrors:
    return LeveragedErrors(error, leverage, np.ones(len(error), dtype=bool))


@pytest.mark.parametrize("inflation", [1.0, 10.0, 200.0])
def test_inflation_of_known_growth_is_found(inflation: float) -> None:
    rng = np.random.default_rng(1)
    leverages = [rng.exponential(0.05, size=4000) for _ in range(5)]
    flights = [errors(0.3 * np.sqrt(1.0 + inflation * h) * rng.normal(size=4000), h) for h in leverages]
    assert fit_inflation(flights, highest=20_000) == pytest.approx(inflation, rel=0.15, abs=0.5)


def test_inflation_stays_within_its_bounds() -> None:
    rng = np.random.default_rng(2)
    leverages = [rng.exponential(0.01, size=500) for _ in range(3)]
    falling = [errors(rng.normal(size=500) / (1.0 + 100.0 * h), h) for h in leverages]
    rising = [errors(rng.normal(size=500) * h, h) for h in leverages]
    assert fit_inflation(falling, highest=1500) == pytest.approx(1.0, abs=0.01)
    assert fit_inflation(rising, highest=50) == pytest.approx(50.0, rel=0.01)
