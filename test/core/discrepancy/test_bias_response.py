# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.bias_response import BiasResponse
from quadpi_core.estimator.fusion import fuse
from quadpi_core.vehicle import SensorNoise

# Above what flights hold of a bias, below where IMU and flight are apart by the fusion's interpolation.
CUTOFF_HZ = 30.0
ERRORS = {
    "a constant force": lambda rates, force: (0.0 * rates, 0.0 * force + [0.3, -0.2, 0.1]),
    "a constant rate": lambda rates, force: (0.0 * rates + [0.02, 0.01, -0.03], 0.0 * force),
    "turned axes": lambda rates, force: (np.cross(rates, TURN), np.cross(force, TURN)),
    "a scale": lambda rates, force: (0.02 * rates, 0.02 * force),
}
TURN = np.radians([1.2, -1.0, 1.1])


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


@pytest.fixture(scope="module", params=[SensorNoise(), SensorNoise(mocap_delay_std_s=0.0)], ids=["", "exact"])
def reported(request, noisy_vehicle, simulate_flight):
    """reported(name) → vehicle, flight, its error (rates, force) and what the fusion makes of that."""
    vehicle = replace(noisy_vehicle, noise=request.param)
    recording = simulate_flight(0, vehicle=vehicle, duration=16.0).recording
    imu = recording.imu

    def fused(rates=0.0, force=0.0):
        changed = replace(
            imu, angular_velocity=imu.angular_velocity + rates, specific_force=imu.specific_force + force
        )
        return fuse(replace(recording, imu=changed), vehicle, CUTOFF_HZ)

    honest = fused()
    first = int(np.searchsorted(imu.time_ns, honest.start_ns))
    at_flight = slice(first, first + len(honest))

    def make(name):
        # Of what is true: the noise of samples is no part of a flight.
        errors = ERRORS[name](on_imu(honest.rates), on_imu(honest.specific_force))
        wrong = fused(*errors)
        made = wrong.rates - honest.rates, wrong.specific_force - honest.specific_force
        return vehicle, honest, tuple(error[at_flight] for error in errors), made

    def on_imu(values):
        time = 1e-9 * (imu.time_ns - honest.start_ns)
        return np.stack([np.interp(time, honest.time, column) for column in values.T], axis=1)

    return make


@pytest.mark.parametrize("name", ERRORS)
def test_a_flight_holds_what_the_biases_leave(reported, name):
    vehicle, flight, (rates, force), made = reported(name)
    biases = BiasResponse(flight, vehicle, flight.rate_hz)(rates, force)
    for error, bias, held in zip((rates, force), biases, made, strict=True):
        # The first second is that of the estimator's start.
        missed = (held - (error - bias))[500:]
        by_the_mean = (held - (error - error.mean(axis=0)))[500:]
        assert rms(missed) < 0.1 * rms(by_the_mean) + 1e-4


def test_it_is_linear_and_the_same_of_a_thinned_flight(reported):
    vehicle, flight, (rates, force), _ = reported("turned axes")
    response = BiasResponse(flight, vehicle, flight.rate_hz)
    whole = response(rates, force)
    for part, once in zip(response(-2.0 * rates, -2.0 * force), whole, strict=True):
        np.testing.assert_allclose(part, -2.0 * once, rtol=1e-6, atol=1e-12)
    thinned = flight.slice(slice(None, None, 4))
    thin = BiasResponse(thinned, vehicle, flight.rate_hz)(rates[::4], force[::4])
    for part, once in zip(thin, whole, strict=True):
        np.testing.assert_allclose(part, once[::4], atol=0.03 * np.abs(once).max())


@pytest.mark.parametrize("walk", ["accelerometer_bias_walk", "gyro_bias_walk"])
def test_a_bias_that_hardly_wanders(noisy_vehicle, simulate_flight, walk):
    vehicle = replace(noisy_vehicle, noise=SensorNoise(**{walk: 1e-9}))
    flight = fuse(simulate_flight(1).recording, noisy_vehicle, CUTOFF_HZ)
    error = np.sin(flight.time)[:, None] * [0.01, 0.02, 0.03]
    gyro, accelerometer = BiasResponse(flight, vehicle, 500.0)(error, error)
    still, free = (gyro, accelerometer) if walk.startswith("gyro") else (accelerometer, gyro)
    assert np.ptp(still, axis=0).max() < 1e-4 < np.ptp(free, axis=0).max()


def test_a_flight_shorter_than_a_step(noisy_vehicle, simulate_flight):
    flight = fuse(simulate_flight(1).recording, noisy_vehicle, CUTOFF_HZ)
    short = flight.slice(slice(0, 10))
    error = np.full((10, 3), 0.1)
    for bias in BiasResponse(short, noisy_vehicle, 500.0)(error, error):
        assert bias.shape == (10, 3)
        assert np.isfinite(bias).all()
