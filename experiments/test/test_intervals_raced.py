# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The race of intervals: every rule on flights that are made, and the scores."""

from __future__ import annotations

import re
from types import ModuleType

import numpy as np
import pytest
from interval_rivals import ALPHA, RULES, Race, Said, quantile_regression
from scipy.signal import lfilter

RATE_HZ, SAMPLES, FLIGHTS = 50.0, 1500, 8
# Rules whose guarantee asks for independent samples, or that learn too little of so few flights.
LOOSE = {"SAOCP", "DtACI", "EnbPI"}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def race() -> Race:
    """Flights with a constant of their own each and errors that last, left out in four turns."""
    random, keep = np.random.default_rng(0), np.exp(-1.0 / (0.3 * RATE_HZ))
    noise = random.standard_normal((SAMPLES, FLIGHTS, 6))
    error = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], noise, axis=0) + random.standard_normal(
        (FLIGHTS, 6)
    )
    error[-100:, 0] = np.nan
    speed = random.uniform(0.0, 5.0, (SAMPLES, FLIGHTS))
    return Race(error, np.full(error.shape, 3.0), speed, np.arange(FLIGHTS) % 4, RATE_HZ, 1)


@pytest.mark.parametrize("name", RULES)
def test_rule_covers_flights_left_out(name: str, race: Race) -> None:
    said = RULES[name](race)
    held = np.abs(race.error - said.centre) <= said.half
    known = np.isfinite(race.error)
    assert np.mean(held[known]) == pytest.approx(0.95, abs=0.1 if name in LOOSE else 0.05)


@pytest.mark.parametrize("name", RULES)
def test_rule_knows_neither_the_future_nor_the_present(name: str, race: Race) -> None:
    changed = race.error.copy()
    changed[1000:, 3] += 50.0
    said, other = (
        RULES[name](Race(error, race.half, race.speed, race.turn, RATE_HZ, 1))
        for error in (race.error, changed)
    )
    # Flights of the same turn do not calibrate each other.
    for before, after in zip(said, other, strict=True):
        np.testing.assert_array_equal(before[:1001, 3], after[:1001, 3])
        np.testing.assert_array_equal(before[:-100, 7], after[:-100, 7])


def test_a_centre_that_moves_wins_where_errors_last(race: Race, tool: ModuleType) -> None:
    flights = [
        tool.Errors(0, RATE_HZ, *([np.ones((SAMPLES, 6))] * 2), np.ones(SAMPLES), np.ones(SAMPLES) > 0.0)
    ]
    flights *= FLIGHTS
    whole = Race(np.nan_to_num(race.error), race.half, race.speed, race.turn, RATE_HZ, 1)
    scores = {name: tool.scored(whole, RULES[name](whole), flights, 1).winkler.mean() for name in RULES}
    assert scores["own, both"] < 0.7 * scores["split conformal"]
    assert scores["own, both"] < scores["own, width adapts"]


def test_scores_by_hand(tool: ModuleType) -> None:
    error = np.zeros((200, 1, 6))
    error[:10] = 3.0
    flight = tool.Errors(0, 50.0, error[:, 0], error[:, 0], np.zeros(200), np.arange(200) >= 5)
    whole = Race(error, np.ones(error.shape), np.zeros((200, 1)), np.zeros(1, dtype=np.int64), 50.0, 1)
    result = tool.scored(whole, Said(np.zeros_like(error), np.ones_like(error)), [flight], 1)
    np.testing.assert_allclose(result.winkler, 2.0 + 2.0 / ALPHA * 2.0 * 10 / 200)
    np.testing.assert_allclose(result.coverage, 190 / 195)
    np.testing.assert_allclose(result.worst, 0.9)
    np.testing.assert_allclose(result.width, 2.0)


def test_quantile_regression_finds_the_quantile_of_a_line() -> None:
    random = np.random.default_rng(1)
    inputs = np.column_stack((np.ones(4000), random.uniform(0.0, 4.0, 4000)))
    target = inputs[:, 1] * random.exponential(1.0, 4000)
    found = quantile_regression(inputs, target, 0.9)
    np.testing.assert_allclose(found, [0.0, -np.log(0.1)], atol=0.2)


def test_the_page_has_a_place_for_each_table(tool: ModuleType) -> None:
    assert re.findall(r"^<!-- table: (\S+) -->$", tool.PAGE.read_text(), flags=re.MULTILINE) == [
        "rules",
        "races",
        "methods",
        "regions",
    ]
