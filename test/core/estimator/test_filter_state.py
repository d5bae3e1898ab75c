# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the filter remembers, for how long, and what it assumes of the sensors."""

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
    NOISE,
    allocate,
    assumed_noise,
)
from quadpi_core.flight import NO_STAMP
from quadpi_core.records import Records
from quadpi_core.signals.chain import RATE_SPAN


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
