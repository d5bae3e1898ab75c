# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the filter remembers, for how long, what it assumes of the sensors, and the rate of the IMU."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.core import compiled
from quadpi_core.estimator import filter_state
from quadpi_core.estimator.filter_run import Inputs, Tape
from quadpi_core.estimator.filter_state import (
    CORRECTION,
    ESTIMATE,
    IMU_SAMPLE,
    METER,
    NOISE,
    ImuRate,
    allocate,
    assumed_noise,
)
from quadpi_core.flight import NO_STAMP
from quadpi_core.records import Records
from quadpi_core.signals.chain import RATE_SPAN, nominal_rate


@pytest.fixture
def estimate() -> Records:
    """With another number in each field."""
    estimate = np.zeros(1, ESTIMATE)
    for k, name in enumerate(ESTIMATE.names):
        estimate[name] = 1 + k
    return estimate


@pytest.mark.parametrize("rate_hz", [5.0, 100.0, 500.0, 4000.0])
def test_it_remembers_half_a_second_and_what_a_rate_is_measured_over(noisy_vehicle, rate_hz):
    steps = len(allocate(noisy_vehicle, rate_hz).ring) - 1
    assert steps >= max(0.5 * rate_hz, RATE_SPAN)
    assert steps <= max(0.5 * rate_hz, RATE_SPAN) + 3


def test_noise_of_samples_is_a_density_that_the_rate_does_not_change(noisy_vehicle):
    """An integral over a second of samples with errors of σ each errs by σ / √rate."""
    sensors = noisy_vehicle.noise
    rng = np.random.default_rng(1)
    for rate_hz in (100, 400):
        noise = assumed_noise(noisy_vehicle, rate_hz)[0]
        for density, std in (
            (noise["gyro"], sensors.gyro_noise_rad_s),
            (noise["accelerometer"], sensors.accelerometer_noise_m_s2),
        ):
            integrals = std * rng.standard_normal((5000, rate_hz)).sum(axis=1) / rate_hz
            assert np.var(integrals) == pytest.approx(density, rel=0.1)
        assert noise["rates"] == sensors.gyro_noise_rad_s**2
        assert noise["position"] == sensors.mocap_position_m**2
        assert noise["gravity"] == noisy_vehicle.gravity_m_s2


@pytest.mark.parametrize(("delay_std_s", "drift_s"), [(0.02, 0.55e-3), (0.0, 0.0)])
def test_clocks_drift_by_half_a_millisecond_in_half_a_minute_unless_stamps_are_trusted(
    noisy_vehicle, delay_std_s, drift_s
):
    vehicle = replace(noisy_vehicle, noise=replace(noisy_vehicle.noise, mocap_delay_std_s=delay_std_s))
    noise = assumed_noise(vehicle, 500.0)[0]
    assert np.sqrt(30.0 * noise["delay"]) == pytest.approx(drift_s, rel=0.01)
    assert noise["delay_prior"] == delay_std_s**2


def test_a_start_keeps_the_noise_and_the_counts_and_nothing_else(noisy_vehicle, estimate):
    memory = allocate(noisy_vehicle, 500.0)
    noise = memory.filter["noise"].copy()
    empty = memory.filter.copy()
    memory.filter["counts"] = 7
    for name in ("newest", "filled", "status", "held_count", "rate_off_ns", "journalled"):
        memory.filter[name] = 3
    memory.filter["sources"]["arrived_ns"] = memory.filter["jumped_ns"] = 5
    filter_state.begin(memory, estimate, 10)
    assert memory.filter["corrected"] == estimate
    assert memory.ring["time_ns"][0] == memory.filter["accepted_ns"][0] == 10
    np.testing.assert_array_equal(memory.ring["covariance"][0], estimate["covariance"][0])
    assert memory.filter["filled"] == 1

    filter_state.forget(memory)
    assert memory.filter["noise"] == noise
    assert np.all(memory.filter["counts"] == 7)
    memory.filter["counts"] = 0
    assert memory.filter == empty
    assert np.all(memory.filter["sources"]["arrived_ns"] == NO_STAMP)


def test_a_sample_between_two_is_on_the_line_between_them():
    """Where a correction lies; one of which nothing was measured changes no state."""
    samples, correction = np.zeros(2, IMU_SAMPLE), np.zeros(1, CORRECTION)
    correction["measurement"]["deviation"] = -1.0
    first, second = samples[:1], samples[1:]
    first["time_ns"], second["time_ns"] = 1_000, 3_000
    first["rates"], second["rates"] = [1.0, 2.0, 3.0], [2.0, 0.0, 7.0]
    second["specific_force"] = [4.0, -4.0, 8.0]
    between = np.zeros(1, ESTIMATE)
    for time_ns in (1_000, 1_500, 3_000):
        between["time_ns"] = correction["time_ns"] = time_ns
        inputs = Inputs(samples, correction, np.zeros(1, NOISE))
        assert compiled.forward(inputs, between, 1, 2, 0, Tape.empty(2, 1)) == 1
        for name in ("rates", "specific_force"):
            ends = np.array([first[name][0], second[name][0]])
            expected = [np.interp(time_ns, [1_000, 3_000], column) for column in ends.T]
            np.testing.assert_allclose(between[name][0], expected, rtol=1e-15)


def test_views_of_the_newest_estimate(estimate):
    state = filter_state.State(estimate[0])
    assert state.time_ns == estimate["time_ns"][0]
    for name in ("position", "velocity", "attitude", "gyro_bias", "accelerometer_bias", "covariance"):
        np.testing.assert_array_equal(getattr(state, name), estimate[name][0])
    estimate["position"] = 0.0
    assert not state.position.any()


START_NS = 1_700_000_000_000_000_000


def stamps(rate_hz: float, seconds: float, begin_ns: int = START_NS) -> np.ndarray:
    return begin_ns + np.rint(np.arange(seconds * rate_hz) * 1e9 / rate_hz).astype(np.int64)


def told(time_ns: np.ndarray, given_hz: float = 0.0) -> list[ImuRate]:
    """What a meter says after each stamp."""
    meters, rates = np.zeros(1, METER), []
    for at_ns in time_ns.tolist():
        compiled.follow_rate(meters, at_ns)
        rates.append(ImuRate.from_meters(meters, given_hz))
    return rates


@pytest.mark.parametrize("rate_hz", [50.0, 167.0, 500.0, 4000.0])
def test_the_rate_is_known_after_a_second_and_is_the_nominal_rate(rate_hz: float) -> None:
    rng = np.random.default_rng(5)
    even = stamps(rate_hz, 1.5)
    time_ns = np.sort(even + (rng.uniform(-0.3e9, 0.3e9, len(even)) / rate_hz).astype(np.int64))
    rates = told(time_ns)
    known = next(k for k, rate in enumerate(rates) if rate.filter_hz)
    assert time_ns[known - 1] - time_ns[0] < 1e9 <= time_ns[known] - time_ns[0]
    assert all(rate.begins for rate in rates[:known])
    assert rates[known].filter_hz == nominal_rate(time_ns[: known + 1]) == pytest.approx(rate_hz, rel=0.01)
    assert rates[-1] == rates[known]


def test_stamps_in_whole_milliseconds_repeated_and_lost_samples_change_nothing() -> None:
    rng = np.random.default_rng(6)
    time_ns = stamps(400.0, 20.0) // 1_000_000 * 1_000_000
    time_ns = time_ns[rng.random(len(time_ns)) > 0.05]
    time_ns = np.repeat(time_ns, 1 + (rng.random(len(time_ns)) < 0.1))
    rates = told(time_ns)
    assert rates[-1].filter_hz == pytest.approx(400.0, rel=0.01)
    assert len({rate.filter_hz for rate in rates}) == 2


@pytest.mark.parametrize("share", [0.1, 0.15])
def test_a_link_that_loses_samples_is_no_other_rate(share: float) -> None:
    rng = np.random.default_rng(7)
    time_ns = stamps(500.0, 30.0)
    kept = (rng.random(len(time_ns)) > share) | (time_ns < START_NS + 10**9)
    assert told(time_ns[kept])[-1].filter_hz == pytest.approx(500.0)
    assert not any(rate.lost for rate in told(time_ns[kept]))


@pytest.mark.parametrize("after_hz", [100.0, 167.0, 400.0, 1000.0])
def test_another_rate_in_flight_is_noticed_and_measured_again(after_hz: float) -> None:
    before = stamps(500.0, 3.0)
    after = stamps(after_hz, 2.0, int(before[-1]) + 2_000_000)
    time_ns, rates = np.concatenate((before, after)), told(np.concatenate((before, after)))
    noticed = next(k for k, rate in enumerate(rates) if rate.lost)
    assert 0.0 < 1e-9 * (time_ns[noticed] - after[0]) < 0.35
    assert not rates[noticed].filter_hz
    known = next(k for k in range(noticed, len(rates)) if rates[k].filter_hz)
    assert rates[known].filter_hz == pytest.approx(after_hz)
    assert 1e-9 * (time_ns[known] - time_ns[noticed]) == pytest.approx(1.0, abs=0.02)


def test_a_pause_is_measured_again_one_broken_stamp_is_not() -> None:
    time_ns = stamps(500.0, 2.0)
    time_ns[700] += 10**15
    assert not any(rate.lost for rate in told(time_ns))
    paused = np.concatenate((stamps(500.0, 2.0), stamps(250.0, 1.2, START_NS + 2_500_000_000)))
    rates = told(paused)
    assert rates[1001].lost
    assert not rates[1001].filter_hz
    assert rates[-1] == ImuRate(250.0)


def test_a_clock_that_is_set_back_is_a_new_beginning() -> None:
    rates = told(np.concatenate((stamps(500.0, 2.0), stamps(500.0, 2.0, START_NS - 10**12))))
    assert rates[1400].begins
    assert rates[-1] == ImuRate(500.0)


@pytest.mark.parametrize(("given_hz", "fits"), [(500.0, True), (460.0, True), (440.0, False), (167.0, False)])
def test_a_rate_that_is_given_counts_unless_the_stamps_contradict(given_hz: float, fits: bool) -> None:
    rates = told(stamps(500.0, 1.1), given_hz)
    assert rates[100].filter_hz == 0.0
    assert rates[100].begins
    assert rates[-1].filter_hz == (given_hz if fits else 0.0)
    assert rates[-1].differs is not fits
    if not fits:
        assert str(rates[-1]) == f"stamps say 500 Hz, imu_rate_hz is {given_hz:g}"


@pytest.mark.parametrize(
    ("span_share", "lost"), [(1.115, False), (1.125, True), (0.885, False), (0.875, True)]
)
def test_spans_that_differ_by_an_eighth_are_another_rate(span_share: float, lost: bool) -> None:
    before = stamps(500.0, 2.0)
    after = stamps(500.0 / span_share, 0.5, int(before[-1]) + 2_000_000)
    assert any(rate.lost for rate in told(np.concatenate((before, after)))) == lost


@pytest.mark.parametrize(("fitting", "lost"), [(2, True), (5, False)])
def test_one_span_that_fits_outweighs_four_that_do_not(fitting: int, lost: bool) -> None:
    """Of 500 Hz with ten steps of 4 ms now and then: spans differ for 52 ms, and some fit."""
    steps = np.tile([4] * 10 + [2] * (9 + fitting), 60)
    time_ns = np.concatenate((stamps(500.0, 2.0), START_NS + 2_000_000_000 + 1_000_000 * np.cumsum(steps)))
    assert any(rate.lost for rate in told(time_ns)) == lost


@pytest.mark.parametrize(("gaps", "lost"), [(8, False), (10, True)])
def test_a_gap_counts_for_20_ms(gaps: int, lost: bool) -> None:
    steps = np.concatenate(([90] * gaps, [2] * 20))
    time_ns = np.concatenate((stamps(500.0, 2.0), START_NS + 1_998_000_000 + 1_000_000 * np.cumsum(steps)))
    assert any(rate.lost for rate in told(time_ns)) == lost
