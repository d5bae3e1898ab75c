# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Biases that an estimator attributes to errors of the IMU, and the swing of a load at the start."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy import unmeasured_states
from quadpi_core.discrepancy.candidates import TRIED_LENGTHS
from quadpi_core.discrepancy.unmeasured_states import (
    INDEPENDENT_HZ,
    SEEN_S,
    STRETCHES_S,
    BiasResponse,
    started,
)
from quadpi_core.estimator.fusion import fuse
from quadpi_core.simulation.applied_effects import EFFECTS, effect_wrench, with_memory
from quadpi_core.simulation.simulated_aerodynamics import vehicle_record
from quadpi_core.vehicle import SensorNoise, Vehicle

from ..simulation.two_bodies import flown

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


LOAD = EFFECTS["slung_load"]
STEP_S = 0.008
MASS = Vehicle.load("bebop2").mass_kg


@pytest.fixture(scope="module")
def record():
    return vehicle_record(Vehicle.load("bebop2"), 700.0)


@pytest.fixture(scope="module")
def swung():
    return flown(MASS, 0.03, 0.5, aside=0.4, seconds=24.0, step_s=STEP_S)


def found(flight, record, residual=None, length=0.5):
    states = flight.states(measured=True)
    left = flight.pull_in_body() if residual is None else residual
    return started(LOAD, np.array([9.9, length, 0.0, 0.0]), states, record, left, STEP_S)


def test_direction_rate_and_mass_are_found(swung, record):
    start = found(swung, record)
    direction = start.memory[:3] / np.linalg.norm(start.memory[:3])
    np.testing.assert_allclose(direction, swung.direction[0], atol=0.02)
    assert np.linalg.norm(start.memory[3:]) < 0.1
    assert start.strength == pytest.approx(0.03, rel=0.02)
    assert start.explained > 0.98


def test_what_follows_is_the_flight(swung, record):
    """Twenty seconds of a swing from the state that was found."""
    parameters = {"mass_kg": 0.03, "length_m": 0.5, "damping_1_s": 0.0, "hook_m": 0.0}
    start = found(swung, record)
    own = with_memory("slung_load", parameters, swung.states(measured=True), record, start.memory, STEP_S)
    added = effect_wrench("slung_load", parameters, own, record)
    late = swung.time > 4.0
    assert np.std((added - swung.pull_in_body())[late, :2]) < 0.15 * np.std(swung.pull_in_body()[late, :2])


def test_steady_errors_of_thrust_do_not_disturb_it(swung, record):
    beside = swung.pull_in_body() + np.array([0.05, -0.1, 0.4, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(found(swung, record, beside).memory, found(swung, record).memory, atol=1e-3)


def test_nothing_to_explain_gives_no_strength(swung, record):
    start = found(swung, record, np.zeros((len(swung.time), 6)))
    assert (start.strength, start.cost) == (0.0, 0.0)
    assert np.all(np.isfinite(start.memory))


def test_a_start_that_is_known_nearly_is_found_in_fewer_steps(swung, record, monkeypatch):
    """A centimetre of cable on, by the derivatives that are known, as from the beginning."""
    states, followed = swung.states(measured=True), []
    given = states, record, swung.pull_in_body(), STEP_S
    near = started(LOAD, np.array([1.0, 0.5, 0.0, 0.0]), *given)
    forces = unmeasured_states.remembered_wrenches

    def counted(*args, **kwargs):
        found = forces(*args, **kwargs)
        followed.append(found.shape[2])
        return found

    monkeypatch.setattr(unmeasured_states, "remembered_wrenches", counted)
    anew = started(LOAD, np.array([1.0, 0.51, 0.0, 0.0]), *given)
    whole, followed[:] = sum(followed), []
    started(LOAD, np.array([1.0, 0.51, 0.0, 0.0]), *given, near._replace(slopes=None))
    without, followed[:] = sum(followed), []
    on = started(LOAD, np.array([1.0, 0.51, 0.0, 0.0]), *given, near)
    hanging, also = (own.memory[:3] / np.linalg.norm(own.memory[:3]) for own in (on, anew))
    np.testing.assert_allclose(hanging, also, atol=1e-3)
    assert on.explained == pytest.approx(anew.explained, abs=1e-3)
    assert sum(followed) < 0.8 * without < 0.2 * whole


@pytest.mark.parametrize("length", [0.05, 0.15])
def test_a_swing_faster_than_the_samples_stays_finite(swung, record, length):
    states = swung.states(measured=True)
    states["wrench"][:, :3] *= 1.0 + 5.0 * np.sin(30.0 * swung.time)[:, np.newaxis]
    parameters = {"mass_kg": 0.03, "length_m": length, "damping_1_s": 0.0, "hook_m": 0.0}
    aside = np.array([1.0, 0.0, 0.1, 0.0, 5.0, 0.0])
    own = with_memory("slung_load", parameters, states, record, aside, STEP_S)
    assert np.all(np.isfinite(own["memory"]))
    start = started(LOAD, np.array([1.0, length, 0.0, 0.0]), states, record, swung.pull_in_body(), STEP_S)
    assert np.all(np.isfinite([*start.memory, start.strength, start.explained, start.cost]))


def test_a_wide_swing_is_found(record):
    """From rest, all of its 20 seconds at once lead to an optimum that explains 23 %."""
    wide = flown(MASS, 0.03, 0.5, aside=0.8, seconds=24.0, step_s=STEP_S)
    assert found(wide, record).explained > 0.99


def test_each_stretch_begins_where_the_one_before_ended(record, monkeypatch):
    """With stretches twice as long, the first of them already holds too many swings."""
    assert STRETCHES_S.value == (2.5, 5.0, 10.0, SEEN_S.value)
    monkeypatch.setattr(unmeasured_states, "_FIRST_STATES", unmeasured_states._FIRST_STATES[:1])
    wide = flown(MASS, 0.03, 0.25, aside=1.2, seconds=24.0, step_s=STEP_S)
    assert found(wide, record, length=0.25).explained > 0.99


def test_the_first_stretch_is_explained_from_several_states(record, monkeypatch):
    """From rest alone, so wide a swing ends in a wrong optimum."""
    wide = flown(MASS, 0.03, 1.0, aside=1.5, seconds=24.0, step_s=STEP_S)
    several = found(wide, record, length=1.0).explained
    monkeypatch.setattr(unmeasured_states, "_FIRST_STATES", unmeasured_states._FIRST_STATES[:1])
    assert found(wide, record, length=1.0).explained < 0.1 * several
    assert several > 0.3


def test_a_swing_that_is_not_found_is_left_at_rest(record):
    """So wide a one ends in a wrong optimum, which explains less than its freedom costs."""
    start = found(flown(MASS, 0.03, 1.0, aside=1.2, seconds=24.0, step_s=STEP_S), record, length=1.0)
    assert start.memory.tolist() == list(LOAD.at_rest)
    assert start.cost == 0.0


def test_the_first_seconds_decide(swung, record):
    """Exactly those of the threshold."""
    assert SEEN_S.value == 20.0
    before = found(swung, record).memory
    for second, moved in ((0.99 * 20.0, True), (1.01 * 20.0, False)):
        residual = swung.pull_in_body()
        residual[np.abs(swung.time - second) < 0.09] += 1.0
        assert np.array_equal(found(swung, record, residual).memory, before) != moved


def test_freedom_costs_more_the_more_samples_are_independent(swung, record):
    """Half the logarithm of the information, for each of the five directions in which a start can differ."""
    assert INDEPENDENT_HZ.value == 5.0
    noise = np.random.default_rng(1).normal(0.0, 0.01, (len(swung.time), 6))
    loud = found(swung, record, swung.pull_in_body() + 4.0 * noise).cost
    quiet = found(swung, record, swung.pull_in_body() + noise).cost
    assert 15.0 < loud < quiet < 60.0


def test_tried_lengths_are_a_swing_apart_at_most():
    periods = np.sqrt(TRIED_LENGTHS.value)
    assert np.all(periods[1:] / periods[:-1] < 1.26)
    assert (TRIED_LENGTHS.value[0], TRIED_LENGTHS.value[-1]) == (0.15, 3.8)


@pytest.mark.slow
def test_the_load_of_real_flights_is_found(shared_data, tmp_path, quadpi):
    """4.7 g on 0.52 m, below a Crazyflie whose model is of flights without it."""
    bare = [
        shared_data / "imrc_brushless" / f"eckart{number}" for number in ("00", "04", "08", "13", "17", "20")
    ]
    quadpi("identify", *bare, "--vehicle", "crazyflie_rpm", "-o", tmp_path / "bare")
    loaded = [shared_data / "imrc_payload" / f"eckart{number}" for number in (14, 20, 46, 61, 68)]
    names = "slung_load,thrust_coefficient,tether,wind,rotor_drag"
    result = tmp_path / "found.json"
    quadpi(
        "discrepancy",
        tmp_path / "bare",
        *loaded,
        "-o",
        tmp_path / "found",
        "--effects",
        names,
        "--json",
        result,
    )
    effects = {effect["name"]: effect for effect in json.loads(result.read_text())["effects"]}
    load = effects["slung_load"]
    values = {name: parameter["value"] for name, parameter in load["parameters"].items()}
    assert values["mass_kg"] == pytest.approx(4.7e-3, rel=0.1)
    assert values["length_m"] == pytest.approx(0.52, rel=0.1)
    # The weight of what is fixed to the vehicle, as less thrust: these effects have no payload.
    assert effects.keys() <= {"slung_load", "thrust_coefficient"}
