# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import (
    FEWEST_INSIDE,
    LEVELS,
    MEMORIES_S,
    SETTLED,
    FlightErrors,
    HeldOutRule,
    LevelSupport,
    MovedAxis,
    MovingCentre,
    NormalRule,
    ResidualRule,
    Rule,
    StateDeviation,
    TrainedRule,
    calibrate,
    delayed,
    flights_peak,
    means_of,
    regressed,
    rule_from_json,
)


def flight_errors(error: Array, spread: Array | None = None, inside_share: float = 1.0) -> FlightErrors:
    count = len(error)
    return FlightErrors(
        error,
        np.ones(count) if spread is None else spread,
        np.arange(count) < inside_share * count,
    )


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_factors_of_a_flight_cover_it(scale: float) -> None:
    rng = np.random.default_rng(3)
    error, spread = rng.normal(scale=scale, size=5000), 1.0 + rng.exponential(0.01, size=5000)
    factors = flight_errors(error, spread).factors()
    for level, factor in zip(LEVELS, factors, strict=True):
        assert level <= np.mean(np.abs(error) <= factor * spread) <= level + 0.001


def test_calibration_covers_each_flight_left_out_and_in_the_final_fit() -> None:
    rng = np.random.default_rng(4)
    held_out = [flight_errors(rng.normal(scale=scale, size=2000)) for scale in (1.0, 3.0, 2.0)]
    trained = [flight_errors(rng.normal(scale=scale, size=2000)) for scale in (1.5, 1.0, 1.0)]
    rule = calibrate(held_out, trained)
    for row, out, own in zip(rule.flight_factors, held_out, trained, strict=True):
        expected = np.maximum(out.factors(), own.factors())
        np.testing.assert_array_equal(row, expected)


def test_other_errors_of_the_same_flights_widen_and_never_narrow() -> None:
    rng = np.random.default_rng(6)
    flights = [flight_errors(rng.normal(scale=scale, size=2000)) for scale in (1.0, 2.0, 3.0)]
    rule = calibrate(flights, flights)
    other = [flight_errors(rng.normal(scale=scale, size=2000)) for scale in (1.5, 1.0)]
    other.append(flight_errors(rng.normal(scale=9.0, size=2000), inside_share=FEWEST_INSIDE - 0.01))
    wider = rule.covering(other)
    np.testing.assert_array_equal(wider.flight_factors[0], other[0].factors())
    np.testing.assert_array_equal(wider.flight_factors[1:], rule.flight_factors[1:])
    nothing_known = flight_errors(np.empty(0))
    np.testing.assert_array_equal(rule.covering([nothing_known] * 3).flight_factors, rule.flight_factors)


def test_flight_outside_the_envelope_of_the_others_does_not_set_the_width() -> None:
    rng = np.random.default_rng(5)
    trained = [flight_errors(rng.normal(size=1000)) for _ in range(4)]
    wild = 100.0 * rng.normal(size=1000)
    within = [flight_errors(rng.normal(size=1000)) for _ in range(3)]
    outside = [*within, flight_errors(wild, inside_share=FEWEST_INSIDE - 0.01)]
    inside = [*within, flight_errors(wild, inside_share=FEWEST_INSIDE)]
    assert calibrate(outside, trained).factor(0.95) < 3.0
    assert calibrate(inside, trained).factor(0.95) > 100.0


@pytest.mark.parametrize(("flights", "rank"), [(2, 2), (5, 5), (9, 9), (10, 10), (19, 18), (29, 27)])
def test_factor_is_the_conformal_rank_of_the_flights(flights: int, rank: int) -> None:
    factors = np.random.default_rng(6).permutation(np.arange(1.0, flights + 1.0))
    rule = HeldOutRule(np.repeat(factors[:, None], len(LEVELS), axis=1), 0)
    assert rule.factor(0.95) == rank


def test_nine_tenths_of_new_flights_reach_the_nominal_coverage() -> None:
    """The guarantee of split conformal prediction by group: exchangeable flights, here of unlike rule."""
    rng = np.random.default_rng(7)
    reached = []
    for _ in range(400):
        flights = [flight_errors(s * rng.normal(size=200)) for s in rng.lognormal(sigma=0.5, size=30)]
        known, new = flights[:-1], flights[-1]
        rule = HeldOutRule(np.stack([flight.factors() for flight in known]), 0)
        reached.append(np.mean(np.abs(new.error) <= rule.factor(0.9)) >= 0.9)
    assert np.mean(reached) == pytest.approx(0.9, abs=0.045)


@pytest.mark.parametrize(
    "rule",
    [ResidualRule(0.3, 98.0), NormalRule(), TrainedRule(0.9), HeldOutRule(np.ones((3, len(LEVELS))), 2)],
)
def test_json_round_trip(rule: Rule) -> None:
    again = rule_from_json(json.loads(json.dumps(rule.to_json())))
    assert type(again) is type(rule)
    assert again.factor(0.9) == rule.factor(0.9)


def test_textbook_factors() -> None:
    assert NormalRule().factor(0.95) == pytest.approx(1.959964, abs=1e-6)
    assert ResidualRule(2.0, 9.0).factor(0.95) == pytest.approx(2.0 * 2.262157, abs=1e-5)
    assert TrainedRule(0.95).factor(0.95) == 1.0
    with pytest.raises(ModelError, match=r"trained for a confidence of 0\.95, not 0\.9"):
        TrainedRule(0.95).factor(0.9)


@pytest.mark.parametrize(
    "data",
    [
        {"kind": "magic"},
        {"kind": "residual", "std": -1.0, "freedom": 3},
        {"kind": "residual", "std": 1.0, "freedom": 0},
        {"kind": "held-out", "flights_inside": 1, "flight_factors": [[1.0] * 3]},
        {"kind": "held-out", "flights_inside": 1, "flight_factors": []},
    ],
)
def test_impossible_rule_is_refused(data: dict[str, object]) -> None:
    with pytest.raises(ModelError):
        rule_from_json(data)


def test_held_out_coverage_uses_the_factors_of_the_others() -> None:
    rng = np.random.default_rng(5)

    def flight(scale: float) -> FlightErrors:
        return FlightErrors(scale * rng.normal(size=4000), np.ones(4000), np.ones(4000, dtype=bool))

    calm, rough = flight(1.0), flight(3.0)
    rule = calibrate([calm, rough], [calm, rough])
    covered = rule.held_out_coverage([calm, rough], 0.95)
    assert covered[0] == 1.0
    np.testing.assert_allclose(
        covered[1], np.mean(np.abs(rough.error) < np.quantile(np.abs(calm.error), 0.95)), atol=2e-3
    )


def test_a_flight_counts_from_half_inside() -> None:
    trained = [flight_errors(np.ones(1000)) for _ in range(3)]
    held_out = [flight_errors(np.ones(1000), inside_share=share) for share in (0.49, 0.5, 0.51)]
    assert calibrate(held_out, trained).flights_inside == 2


def test_a_thousandth_of_a_flight_is_above_its_peak() -> None:
    assert flights_peak([np.arange(1001.0), np.zeros(10)]) == pytest.approx(999.0)


@pytest.mark.parametrize(
    ("confidence", "flights", "sentence"),
    [
        (
            0.999,
            2,
            "2 flights, each counted once, support a level of 66.67 % (n / (n + 1)), not 99.9 %: "
            "about 66.67 % of flights to come reach 99.9 % of their samples",
        ),
        (
            0.95,
            20,
            "20 flights, each counted once, support a level of 95.24 % (n / (n + 1)): "
            "about 90.48 % of flights to come reach 95 % of their samples",
        ),
        (
            0.5,
            1,
            "1 flight supports a level of 50 % (n / (n + 1)): "
            "about 50 % of flights to come reach 50 % of their samples",
        ),
        (
            0.95,
            0,
            "no flight left out calibrated the intervals: they support no level, 95 % is nominal",
        ),
    ],
)
def test_flights_support_no_level_that_none_of_them_could_show(confidence, flights, sentence) -> None:
    assert LevelSupport.from_flights(confidence, flights).sentence() == sentence


# The regression of errors on running means of those before, and how a model keeps it.


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


# How unsure the states of a model's flights were: the median flight, never less than motion capture.


def test_the_median_flight_counts_and_motion_capture_is_the_least():
    found = StateDeviation.of_flights([(0.08, 0.001), (0.09, 0.002), (0.5, 0.003)])
    assert found.velocity_m_s == pytest.approx(0.09)
    assert found.attitude_rad == SETTLED.attitude_rad
    assert StateDeviation.of_flights([(0.001, 0.001)]) == SETTLED
