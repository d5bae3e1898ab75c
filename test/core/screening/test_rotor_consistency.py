# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence of rotors whose thrust and torque are proportional to their squared speeds, and of no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from quadpi_core.screening.clock_consistency import rotor_evidence
from quadpi_core.screening.excerpt import STEP_S, RotorExcerpt
from quadpi_core.vehicle import Vehicle
from test.core.multicopters import framed_file, multicopter

WINDOWS, CELLS, MARGIN = 6, 250, 40
TORQUE_PER_THRUST_M = 0.02


@pytest.fixture
def flown(vehicle):
    """flown(lag_s) → what a vehicle without damping does, its rotor speeds late by so much."""

    def fly(lag_s: float = 0.0, noise: float = 0.0, vehicle: Vehicle = vehicle) -> RotorExcerpt:
        rng, count = np.random.default_rng(4), vehicle.rotor_count
        swing = gaussian_filter1d(rng.standard_normal((WINDOWS, CELLS + 2 * MARGIN, count)), 2.0, axis=1)
        squares = 4e5 * (1.0 + 0.3 * swing)
        thrust = vehicle.mass_kg * vehicle.gravity_m_s2 / count * squares / 4e5
        places, spins = vehicle.rotor_positions, vehicle.rotor_spins
        # Rotors push up: M = r × (0, 0, -T); a rotor that turns clockwise pushes the body anticlockwise.
        moment = np.stack(
            (-thrust @ places[:, 1], thrust @ places[:, 0], -TORQUE_PER_THRUST_M * thrust @ spins), axis=2
        )
        rates = np.cumsum(moment / np.diag(vehicle.inertia), axis=1) * STEP_S
        rates += noise * rng.standard_normal(rates.shape)
        force = np.zeros_like(rates)
        force[..., 2] = -thrust.sum(axis=2) / vehicle.mass_kg
        late = round(lag_s / STEP_S)
        inside = slice(MARGIN, MARGIN + CELLS)
        return RotorExcerpt(
            STEP_S, rates[:, inside], force[:, inside], np.roll(squares, late, axis=1), MARGIN
        )

    return fly


def test_a_vehicle_as_in_its_file_agrees_with_it(flown, vehicle):
    found = rotor_evidence(flown(), vehicle)
    assert found.explained > 0.95
    assert found.lag_s == 0.0
    assert found.explained_now == found.explained
    assert np.all(found.correlation > 0.99)
    np.testing.assert_allclose(found.ratio, 1.0, atol=0.05)
    assert (found.order, found.spins_inverted) == ((0, 1, 2, 3), False)
    np.testing.assert_array_equal(found.order_correlation, found.correlation)
    np.testing.assert_allclose(found.mean_squares, 4e5, rtol=0.05)


@pytest.mark.parametrize("lag_s", [-0.3, -0.05, 0.02, 0.29])
def test_the_lag_of_the_rotor_speeds_is_found_up_to_0_3_s(flown, vehicle, lag_s):
    found = rotor_evidence(flown(lag_s), vehicle)
    assert found.lag_s == pytest.approx(lag_s)
    assert found.explained > 0.95
    assert found.explained_now < 0.5


def test_a_larger_lag_is_not_tried(flown, vehicle):
    found = rotor_evidence(flown(0.36), vehicle)
    assert found.explained < 0.5


@pytest.mark.parametrize("order", [(1, 0, 2, 3), (2, 1, 0, 3), (1, 2, 3, 0)])
def test_another_order_of_the_columns_is_found(flown, vehicle, order):
    sample = flown()
    found = rotor_evidence(replace(sample, squares=sample.squares[..., list(order)]), vehicle)
    # Column order[k] came at place k, so rotor order[k] is found there.
    assert found.order == tuple(np.argsort(order).tolist())
    assert not found.spins_inverted
    assert np.all(found.order_correlation > 0.99)
    assert found.correlation.min() < 0.7


@pytest.mark.parametrize("rotors", [3, 6, 8, "octo-coaxial-x"])
def test_orders_of_other_numbers_of_rotors_are_found(flown, tmp_path, rotors):
    if isinstance(rotors, int):
        other = multicopter(tmp_path, rotors)
    else:
        other = Vehicle.load(framed_file(tmp_path, rotors))
    sample, same = flown(vehicle=other), tuple(range(other.rotor_count))
    assert rotor_evidence(sample, other).order == same
    for order in (same[1:] + same[:1], same[::-1], (same[2], *same[1:2], same[0], *same[3:])):
        found = rotor_evidence(replace(sample, squares=sample.squares[..., np.argsort(order)]), other)
        assert (found.order, found.spins_inverted) == (order, False)
        assert np.all(found.order_correlation > 0.99)


def test_inverted_spins_and_inertia_are_found(flown, vehicle):
    inverted = rotor_evidence(flown(), replace(vehicle, rotor_spins=-vehicle.rotor_spins))
    assert inverted.spins_inverted
    assert inverted.correlation[2] < -0.99
    assert np.all(inverted.order_correlation > 0.99)
    heavy = rotor_evidence(flown(), replace(vehicle, inertia=3.0 * vehicle.inertia))
    np.testing.assert_allclose(heavy.ratio, 3.0, atol=0.15)


def test_damping_by_the_rates_is_not_held_against_the_rotors(flown, vehicle):
    """A signal proportional to the rates is left out of both sides."""
    sample = flown()
    decay = np.exp(-STEP_S / 0.3)
    damped = np.empty_like(sample.rates)
    damped[:, 0] = 0.0
    for k, step in enumerate(np.moveaxis(np.diff(sample.rates, axis=1), 1, 0)):
        damped[:, k + 1] = decay * damped[:, k] + step
    found = rotor_evidence(replace(sample, rates=damped), vehicle)
    assert np.all(found.correlation > 0.99)
    np.testing.assert_allclose(found.ratio, 1.0, atol=0.1)


@pytest.mark.parametrize(("share", "counts"), [(0.35, False), (0.45, True)])
def test_windows_on_the_ground_do_not_count(flown, vehicle, share, counts):
    """Slow rotors, and motion that has nothing to do with them."""
    sample = flown()
    squares, rates = sample.squares.copy(), sample.rates.copy()
    squares[:3] *= share / squares[:3].sum(axis=2).mean() * squares[3:].sum(axis=2).mean()
    rates[:3] = np.random.default_rng(5).standard_normal(rates[:3].shape)
    found = rotor_evidence(replace(sample, squares=squares, rates=rates), vehicle)
    assert (found.explained < 0.9) == counts


def test_rotors_that_never_turn_show_nothing(flown, vehicle):
    sample = flown()
    assert rotor_evidence(replace(sample, squares=0.0 * sample.squares), vehicle) is None


def test_rotor_speeds_of_other_windows_are_not_followed(flown, vehicle):
    sample = flown(noise=1e-3)
    assert rotor_evidence(sample, vehicle).followed > 0.9
    foreign = replace(sample, squares=np.roll(sample.squares, 1, axis=0))
    assert rotor_evidence(foreign, vehicle).followed < 0.2


def test_motion_below_the_noise_of_the_sensors_does_not_tell_whose_rotors_they_are(flown, vehicle):
    assert rotor_evidence(flown(noise=3.0), vehicle).followed is None


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_the_thrust_grows_with_the_squares_of_speeds(flown, vehicle, power):
    sample = flown()
    squared = replace(sample, squares=4e5 * (sample.squares / 4e5) ** power)
    assert rotor_evidence(squared, vehicle).growth == pytest.approx(1.0 / power, abs=0.08)


def test_two_rotors_that_read_the_same_are_one(flown, vehicle):
    sample = flown()
    assert rotor_evidence(sample, vehicle).same is None
    assert rotor_evidence(replace(sample, squares=sample.squares[..., [0, 1, 2, 1]]), vehicle).same == (1, 3)
