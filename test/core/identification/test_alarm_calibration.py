# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from quadpi_core.identification.alarm_calibration import LeftOut, calibrate_alarm, hover_rotor_speed
from quadpi_core.inputs import DERIVATIVES, INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.alarm_limits import AlarmLimits, allowance
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.monitor.alarm import Alarm, MonitorSettings
from quadpi_core.monitor.preparation import VERDICT, Prepared
from quadpi_core.results import EXTRAPOLATION, LEVEL_ALARM, MISCOVERAGE

from ..monitor.alarm_samples import step

RATE_HZ = 100
FX = 0
OMEGA = INPUT_INDEX["omega_avg"]


def left_out(seconds: float, seed: int, correlation_s: float = 0.1) -> LeftOut:
    """Inputs and errors that wander, correlated over a time; 5 % of the errors lie outside their interval."""
    rng = np.random.default_rng(seed)
    count = round(seconds * RATE_HZ)
    keep = np.exp(-1.0 / (RATE_HZ * correlation_s))
    noise = rng.standard_normal((count + 500, len(INPUT_NAMES) + 1))
    wander = (np.sqrt(1.0 - keep**2) * lfilter([1.0], [1.0, -keep], noise, axis=0))[500:]
    miss = np.full((count, 6), np.nan)
    miss[:, FX] = np.abs(wander[:, -1]) > 1.96
    width = np.zeros((count, 6))
    width[:, FX] = 0.8 + 0.02 * wander[:, 0] ** 2
    leverage = np.zeros((count, 6))
    inputs = wander[:, :-1].copy()
    return LeftOut(np.arange(count) / RATE_HZ, inputs, *Envelope.flight_range(inputs), leverage, width, miss)


def calibrated(flights: list[LeftOut], rate_per_hour: float = 1.0) -> tuple[Envelope, AlarmLimits]:
    inputs = np.concatenate([flight.inputs for flight in flights])
    labels = np.repeat(np.arange(len(flights)), [len(flight.time) for flight in flights])
    width = np.concatenate([flight.width for flight in flights])
    envelope = Envelope.fit(inputs, labels, np.zeros_like(width), width)
    return calibrate_alarm(
        envelope, flights, confidence=0.95, rate_per_hour=rate_per_hour, hover_rotor_speed=0.0
    )


def raised(envelope: Envelope, limits: AlarmLimits, flight: LeftOut) -> dict[int, int]:
    """How often each cause is raised in a flight."""
    count = len(flight.time)
    alarm = Alarm(envelope, limits, MonitorSettings(), np.arange(6) == FX)
    verdicts = np.zeros(count, VERDICT)
    verdicts["time_ns"] = np.round(1e9 * flight.time)
    verdicts["usable"] = verdicts["settled"] = True
    missed, still = np.nan_to_num(2.0 * flight.miss), np.zeros(count, DERIVATIVES)
    prepared = Prepared(verdicts, flight.inputs, missed, verdicts["time_ns"], still)
    bound = np.ones((count, 6))
    rows = step(alarm, prepared, Evaluation(0.0 * bound, -bound, bound, flight.leverage, flight.width))
    at_alarm = rows.cause_level == LEVEL_ALARM
    begins = (np.diff(at_alarm.astype(int), axis=0, prepend=0) == 1).sum(axis=0)
    return {EXTRAPOLATION: int(begins[0]), MISCOVERAGE: int(begins[1])}


@pytest.mark.slow
@pytest.mark.parametrize("correlation_s", [0.03, 0.3])
def test_stated_rate_holds_on_new_flights_whatever_the_correlation(correlation_s):
    flights = [left_out(60.0, seed, correlation_s) for seed in range(20)]
    envelope, limits = calibrated(flights, rate_per_hour=10.0)
    assert limits.estimate_per_hour is not None
    rate, low, high = limits.estimate_per_hour
    assert low < rate < high
    assert low < 10.0 < high
    counts = [raised(envelope, limits, left_out(3600.0, seed, correlation_s)) for seed in (101, 102)]
    total = sum(sum(count.values()) for count in counts)
    # Poisson: 20 expected in two hours if the rate is met exactly; 31 has a chance of 1 %.
    assert total <= 31
    assert limits.calibrated
    assert limits.flights == 20


@pytest.mark.slow
def test_stated_rate_holds_of_flights_that_differ_from_each_other():
    rate_per_hour, strayed = 20.0, 0
    for lot in range(8):
        flights = [livelier(seed) for seed in range(1000 * lot, 1000 * lot + 10)]
        envelope, limits = calibrated(flights, rate_per_hour)
        unseen = [livelier(seed) for seed in range(1000 * lot + 500, 1000 * lot + 540)]
        strayed += sum(raised(envelope, limits, flight)[EXTRAPOLATION] > 0 for flight in unseen)
    # Of 320 minutes, at half of the rate; both signals rarely stray apart, so fewer are no surprise.
    expected = 320 * 0.5 * rate_per_hour / 60.0
    assert 0.25 * expected < strayed < 1.5 * expected


def livelier(seed: int) -> LeftOut:
    """A minute whose inputs all go further by a factor of its own."""
    flight = left_out(60.0, seed)
    factor = np.exp(np.random.default_rng(10**6 + seed).normal(0.0, 0.25))
    inputs = factor * flight.inputs
    lower, upper = Envelope.flight_range(inputs)
    return replace(
        flight, inputs=inputs, lower=lower, upper=upper, width=0.8 + factor**2 * (flight.width - 0.8)
    )


def test_longer_correlation_asks_for_a_higher_limit_of_the_test():
    limits = [
        calibrated([left_out(60.0, seed, correlation_s) for seed in range(10)])[1].miscoverage_s[FX]
        for correlation_s in (0.03, 0.1, 0.3)
    ]
    assert limits[0] < limits[1] < limits[2]


def test_rarer_false_alarms_ask_for_higher_limits():
    flights = [left_out(60.0, seed) for seed in range(8)]
    (often, often_limits), (rare, rare_limits) = (calibrated(flights, rate) for rate in (10.0, 0.1))
    assert np.all(rare.margin > often.margin)
    assert rare.width_limit[FX] > often.width_limit[FX]
    assert rare_limits.miscoverage_s[FX] > often_limits.miscoverage_s[FX]


def test_no_rate_is_stated_that_the_flights_do_not_carry():
    """At most 25 times below what they would show without an alarm: of 8 min, 22.5 per hour."""
    flights = [left_out(60.0, seed) for seed in range(8)]
    (asked, limits), (least, carried) = (calibrated(flights, rate) for rate in (0.1, 22.5 / 25.0))
    assert limits.rate_per_hour == pytest.approx(22.5 / 25.0, rel=0.01)
    np.testing.assert_allclose(asked.margin, least.margin, rtol=0.01)
    assert "per flight hour on 8 flights, each left out in turn (8 min), the least that they carry" in (
        limits.sentence()
    )
    assert calibrated(flights, 1.0)[1].rate_per_hour == 1.0
    assert "carry" not in calibrated(flights, 1.0)[1].sentence()
    assert carried.rate_per_hour == 22.5 / 25.0


def test_few_flights_are_told_less_of():
    flights = [left_out(60.0, seed) for seed in range(24)]
    few = [calibrated(flights[k::3])[1].miscoverage_s[FX] for k in range(3)]
    assert np.mean(few) > calibrated(flights)[1].miscoverage_s[FX]


def test_what_has_no_signal_keeps_its_plain_limit():
    envelope, limits = calibrated([left_out(60.0, seed) for seed in range(8)])
    assert np.all(envelope.leverage_limit == 1.0)
    assert np.all(envelope.width_limit[1:] == 1.0)
    assert np.all(limits.miscoverage_s[1:] == AlarmLimits().miscoverage_s[1:])


def test_few_flights_or_flights_unlike_each_other_calibrate_nothing():
    few = [left_out(60.0, seed) for seed in range(7)]
    envelope, limits = calibrated(few)
    assert not limits.calibrated
    assert "uncalibrated" in limits.sentence()
    assert np.all(envelope.margin == 0.1)
    apart = []
    for k in range(10):
        flight, shift = left_out(60.0, k), 100.0 * (np.arange(len(INPUT_NAMES)) == k)
        moved = {name: getattr(flight, name) + shift for name in ("inputs", "lower", "upper")}
        apart.append(replace(flight, **moved))
    envelope, limits = calibrated(apart)
    assert not limits.calibrated
    assert np.all(envelope.margin == 0.1)


def test_allowance_lies_between_the_allowed_share_and_the_alternative():
    for confidence in (0.5, 0.8, 0.9, 0.95, 0.99, 0.999):
        low = 1.0 - confidence
        assert low < allowance(confidence) < min(5.0 * low, 0.5 * (1.0 + low))


def test_hover_speed_is_where_the_thrust_carries_the_weight():
    rng = np.random.default_rng(2)
    inputs = np.zeros((1000, len(INPUT_NAMES)))
    inputs[:, OMEGA] = rng.uniform(500.0, 900.0, 1000)
    wrench = np.zeros((1000, 6))
    wrench[:, 2] = -1e-5 * inputs[:, OMEGA] ** 2
    assert hover_rotor_speed(inputs, wrench, 4.9) == pytest.approx(700.0)
    assert hover_rotor_speed(inputs, -wrench, 4.9) == 0.0


def test_one_flight_beyond_an_end_that_all_others_share_does_not_loosen_all_inputs():
    rng, time, zero = np.random.default_rng(11), np.arange(600) / RATE_HZ, np.zeros((600, 6))
    reach = rng.uniform(0.9, 1.1, (12, len(INPUT_NAMES)))
    reach[:, 0] = rng.uniform(0.999, 1.001, 12)

    def margins(reach):
        flights = []
        for ends in reach:
            inputs = ends * np.sin(2.0 * np.pi * time / time[-1])[:, None]
            flights.append(LeftOut(time, inputs, *Envelope.flight_range(inputs), zero, zero, zero))
        stacked = np.concatenate([flight.inputs for flight in flights])
        envelope = Envelope.fit(
            stacked, np.repeat(np.arange(12), 600), np.tile(zero, (12, 1)), np.tile(zero, (12, 1))
        )
        return calibrate_alarm(envelope, flights, confidence=0.95, rate_per_hour=1.0, hover_rotor_speed=0.0)[
            0
        ].margin

    farther = reach.copy()
    farther[3, 0] = 1.2
    before, after = margins(reach), margins(farther)
    assert np.median(after[1:] / before[1:]) < 2.1


def test_flights_that_are_all_alike_may_still_differ_by_the_usual_spread():
    """By mean excesses of 0.5 spreads between ends, 0.4 and 0.1 in the logarithms of leverage and width."""
    time = np.arange(6000) / RATE_HZ
    inputs = np.sin(0.7 * time[:, None] + np.arange(len(INPUT_NAMES)))
    one = np.zeros((len(time), 6))
    one[:, FX] = 1.0
    miss = np.where(one > 0.0, 0.0, np.nan)
    alike = LeftOut(time, inputs, *Envelope.flight_range(inputs), one, one, miss)
    labels = np.repeat(np.arange(8), len(time))
    tiled = np.tile(one, (8, 1))
    envelope = Envelope.fit(np.tile(inputs, (8, 1)), labels, tiled, tiled)
    rates = (1.0, 30.0)
    rare, often = (
        calibrate_alarm(envelope, [alike] * 8, confidence=0.95, rate_per_hour=rate, hover_rotor_speed=0.0)[0]
        for rate in rates
    )
    found = (
        rare.margin[0] - often.margin[0],
        np.log(rare.leverage_limit[FX] / often.leverage_limit[FX]),
        np.log(rare.width_limit[FX] / often.width_limit[FX]),
    )
    expected = []
    # Half of eight alike and what is usual six times; ends count as different by a hundredth of their range.
    # Of the alarms of EXTRAPOLATION the inputs have half, leverage and width a quarter each.
    for part, usual, unit in ((0.5, 0.5, 0.01), (0.25, 0.4, 1.0), (0.25, 0.1, 1.0)):
        chances = -np.expm1(-0.5 * np.array(rates) * time[-1] / 3600.0 * part)
        folds = (0.5 / chances) ** 0.1
        expected.append(unit * (4 * 0.02 + 6 * usual) * (folds[0] - folds[1]))
    np.testing.assert_allclose(found, expected, rtol=1e-6)
