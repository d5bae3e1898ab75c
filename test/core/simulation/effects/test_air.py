# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Wind that nothing measures: repeatable, and with the statistics that it promises."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.simulation.applied_effects import EFFECTS, added_wind, read_effects

EACH = pytest.mark.parametrize(
    "effect", [e for e in EFFECTS.values() if e.kind == "wind"], ids=lambda e: e.name
)
TIME = np.arange(0.0, 5.0, 0.002)


def wind(effects, time=TIME, seed=0):
    return added_wind(read_effects(effects, "test"), time, np.random.default_rng(seed))


@EACH
def test_typical_size_blows_and_zero_does_not(effect):
    blowing = wind({effect.name: None})
    assert blowing.shape == (len(TIME), 3)
    assert np.all(np.isfinite(blowing))
    assert np.any(blowing != 0.0)
    zero = {p.name: 0.0 if p.lowest <= 0.0 else p.default for p in effect.parameters}
    assert np.all(wind({effect.name: zero}) == 0.0)


@EACH
def test_the_seed_decides(effect):
    assert np.array_equal(wind({effect.name: None}), wind({effect.name: None}))


def test_another_seed_is_another_gust():
    assert np.abs(wind({"gust": None}) - wind({"gust": None}, seed=1)).max() > 0.5


def test_steady_wind_has_its_direction_and_adds_to_gusts():
    steady = {"north_m_s": 3.0, "east_m_s": -1.0, "down_m_s": 0.5}
    assert np.all(wind({"wind": steady}) == [3.0, -1.0, 0.5])
    both = wind({"wind": steady, "gust": None})
    np.testing.assert_allclose(both - wind({"gust": None}), np.tile([3.0, -1.0, 0.5], (len(TIME), 1)))


def test_gust_has_its_intensity_and_time_on_any_grid():
    rng = np.random.default_rng(1)
    gust = {"intensity_m_s": 2.0, "time_s": 0.5}
    # 20 000 s: 20 000 independent stretches for each axis.
    even = np.arange(0.0, 20_000.0, 0.1)
    uneven = np.sort(rng.uniform(0.0, 20_000.0, len(even)))
    for time in (even, uneven):
        values = wind({"gust": gust}, time)
        np.testing.assert_allclose(values.std(axis=0), 2.0, rtol=0.04)
        np.testing.assert_allclose(values.mean(axis=0), 0.0, atol=0.06)
        correlation = np.corrcoef(values, rowvar=False)
        np.testing.assert_allclose(correlation, np.eye(3), atol=0.04)
    values = wind({"gust": gust}, even)
    for lag in (1, 5, 15):
        kept = (values[lag:] * values[:-lag]).mean(axis=0) / 4.0
        np.testing.assert_allclose(kept, np.exp(-0.1 * lag / 0.5), atol=0.04)


def test_gust_is_stationary_from_its_first_sample():
    first = np.array([wind({"gust": None}, TIME[:1], seed)[0] for seed in range(2000)])
    np.testing.assert_allclose(first.std(axis=0), 1.2, rtol=0.06)
