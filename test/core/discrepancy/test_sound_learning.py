# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What sound flights leave: noise and known errors of made-up spectra, and of an identified model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.sound_learning import known_errors, learned, learned_from
from quadpi_core.discrepancy.study import discover
from quadpi_core.discrepancy.whitening import EDGES_HZ, Spectrum
from quadpi_core.identification.prepared_flights import PreparedFlight, read_flight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle

BANDS = len(EDGES_HZ.value) - 1
NOISE = np.geomspace(0.01, 100.0, 6 * BANDS).reshape(6, BANDS)
FLIGHTS, COLUMNS, SHARED, OF_FLIGHT = 10, 12, 3, 7
NAMES = [(f"effect {k}", "x") for k in range(COLUMNS)]
SCALE = np.geomspace(1e-6, 10.0, COLUMNS)


def spectra(shared=0.0, of_flight=0.0, bands=BANDS, seed=0):
    """Of flights with noise, and errors in two of the columns, in prior deviations."""
    rng = np.random.default_rng(seed)
    band = np.repeat(np.arange(bands), 60)
    deviation = np.sqrt(NOISE[:, band])
    flights = []
    for _ in range(FLIGHTS):
        columns = 0.5 * deviation[:, :, None] * rng.standard_normal((6, len(band), COLUMNS))
        left = deviation * rng.standard_normal(deviation.shape)
        left += shared * columns[:, :, SHARED] + of_flight * rng.standard_normal() * columns[:, :, OF_FLIGHT]
        flights.append(Spectrum(np.dstack((left, columns)), band))
    return flights


def test_an_error_of_all_flights_one_of_each_and_the_noise_are_told_apart():
    sound = learned(spectra(shared=0.4, of_flight=0.5), NAMES, SCALE)
    assert sound.names == (NAMES[SHARED], NAMES[OF_FLIGHT])
    mean, of_flight = sound.mean / SCALE[[SHARED, OF_FLIGHT]], sound.of_flight / SCALE[[SHARED, OF_FLIGHT]]
    assert mean[0] == pytest.approx(0.4, abs=0.03)
    assert of_flight[0] < 0.05
    assert of_flight[1] == pytest.approx(0.5, rel=0.5)
    deviation = np.sqrt(np.diag(sound.covariance)) / SCALE[[SHARED, OF_FLIGHT]]
    assert abs(mean[0] - 0.4) < 3.0 * deviation[0] < 0.1
    np.testing.assert_allclose(sound.noise, NOISE, rtol=0.25)
    assert np.mean(sound.noise / NOISE) == pytest.approx(1.0, abs=0.02)
    # Either error adds about (0.5 · 0.45)² of the noise to what is left.
    assert np.mean(sound.left / sound.noise) == pytest.approx(1.0 + 0.25 * (0.4**2 + 0.5**2), abs=0.06)
    assert np.all(sound.differ > 0.0)


def test_an_error_that_is_larger_than_any_effect_is_not_known():
    assert learned(spectra(shared=4.5), NAMES, SCALE).names == (NAMES[SHARED],)
    assert learned(spectra(shared=5.5), NAMES, SCALE).names == ()


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_has_no_known_errors(seed):
    assert learned(spectra(seed=seed), NAMES, SCALE).names == ()


def test_what_a_fit_without_a_flight_leaves_open_is_no_noise():
    rng = np.random.default_rng(1)
    flights = []
    for flight in spectra():
        open_ = 3.0 * np.sqrt(NOISE[:, flight.band]) * rng.standard_normal(flight.rows.shape[:2])
        rows = np.dstack((flight.rows, open_))
        rows[:, :, 0] += rng.standard_normal() * open_
        flights.append(Spectrum(rows, flight.band))
    sound = learned(flights, NAMES, SCALE)
    assert sound.names == ()
    for found in (sound.noise, sound.left):
        assert np.mean(found / NOISE) == pytest.approx(1.0, abs=0.03)


def test_models_without_a_flight_may_have_more_coefficients_than_another():
    flights = list(spectra())
    wider = Spectrum(np.dstack((flights[0].rows, np.zeros((*flights[0].rows.shape[:2], 2)))), flights[0].band)
    same, found = (learned(some, NAMES, SCALE) for some in (flights, [wider, *flights[1:]]))
    np.testing.assert_allclose(found.noise, same.noise, rtol=1e-9)


def test_a_scale_of_thrust_is_no_error_that_a_model_is_known_by():
    """Identification fits it, and beside one of mass it would scale all there is."""
    names = {candidate.name for candidate in known_errors(Vehicle.load("bebop2"))}
    assert {"inertia", "weak_rotor", "rotor_drag"} <= names
    assert not names & {"thrust_coefficient", "payload", "rotor_speed_scale", "slung_load"}


def test_one_flight_does_not_tell_what_sound_flights_leave(physical_folder):
    model = AerodynamicModel.load(physical_folder)
    one = [object.__new__(PreparedFlight)]
    assert learned_from(replace(model, sound=None, left_out=({},)), one).sound is None


def test_a_band_that_no_flight_reaches_has_the_noise_of_the_next():
    sound = learned(spectra(bands=BANDS - 2), NAMES, SCALE)
    for values in (sound.noise, sound.left):
        np.testing.assert_array_equal(values[:, -2:], values[:, [-3, -3]])


def test_a_model_knows_what_its_flights_leave_and_finds_nothing_in_further_ones(physical_folder):
    sound = AerodynamicModel.load(physical_folder).sound
    assert sound is not None
    simulation = load_simulation(str(physical_folder))
    assert simulation.sound is not None
    further = read_flight(bags_directory() / "interpolation.mcap", simulation.vehicle, 30.0)
    half = len(further) // 2
    found = discover(simulation, [further.slice(slice(0, half)), further.slice(slice(half, None))])
    assert (found.verdict, found.effects) == ("none", ())
    np.testing.assert_array_equal(found.found.regression.sound.noise, sound.noise)
